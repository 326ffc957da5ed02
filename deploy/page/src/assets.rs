//! The files of the page, embedded from `deploy/page/web`.

/// A file: its name, its media type, its content.
pub(crate) struct Asset {
    pub(crate) name: &'static str,
    pub(crate) kind: &'static str,
    pub(crate) content: &'static str,
}

/// Embeds a JavaScript file.
macro_rules! script {
    ($name:literal) => {
        Asset {
            name: $name,
            kind: "text/javascript",
            content: include_str!(concat!("../web/", $name)),
        }
    };
}

/// All files; a test compares them with the folder.
pub(crate) const ASSETS: &[Asset] = &[
    Asset { name: "index.html", kind: "text/html", content: include_str!("../web/index.html") },
    Asset { name: "style.css", kind: "text/css", content: include_str!("../web/style.css") },
    script!("api.js"),
    script!("app.js"),
    script!("chart.js"),
    script!("dom.js"),
    script!("episodes.js"),
    script!("facts.js"),
    script!("format.js"),
    script!("grid.js"),
    script!("numbers.js"),
    script!("otherwise.js"),
    script!("pictures.js"),
    script!("player.js"),
    script!("processes.js"),
    script!("rows.js"),
    script!("run.js"),
    script!("runs.js"),
    script!("series.js"),
    script!("solids.js"),
    script!("sorting.js"),
    script!("table.js"),
    // Bundled by `deploy/page/three`.
    script!("three.js"),
    script!("turns.js"),
];

/// Returns the file of that name; `index.html` for an empty name.
pub(crate) fn find(name: &str) -> Option<&'static Asset> {
    let name = if name.is_empty() { "index.html" } else { name };
    ASSETS.iter().find(|asset| asset.name == name)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_file_of_the_folder_is_served() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/web");
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let files: BTreeSet<String> = files.map(|name| name.into_string().unwrap()).collect();
        let served: BTreeSet<String> = ASSETS.iter().map(|asset| asset.name.to_owned()).collect();
        assert_eq!(served, files);
    }
}
