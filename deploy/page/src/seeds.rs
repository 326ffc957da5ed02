//! Which runs are seeds of one curve: those that differ only in their seeds, by the same rule as in a report.

use protocol::digest;
use protocol::table::deciding;
use report::OF_NO_CURVE;
use report::origin::Origin;
use run::config::RunConfig;
use run::folder::RunFolder;
use toml::Table;

/// Returns the names of the curve that a run is a seed of; runs with a name in common are seeds of the same curve.
/// Returns no name for a run that has not begun.
pub(crate) fn curve(folder: &RunFolder, config: &RunConfig) -> Vec<String> {
    let origins = Origin::of(folder).map_or(Vec::new(), |origin| origin.marks());
    let Ok(values) = Table::try_from(config) else { return Vec::new() };
    let of_curve = |key: &str| key != "seed" && !OF_NO_CURVE.contains(&key);
    let values = deciding(&values).into_iter().filter(|(key, _)| of_curve(key));
    let values: Vec<String> = values.map(|(key, value)| format!("{key} = {value}\n")).collect();
    origins.iter().map(|origin| digest::sha256(values.iter().chain([origin]))).collect()
}

#[cfg(test)]
mod tests {
    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
    use run::tasks;

    use super::*;

    /// Returns the curve names of a run whose log has this metadata.
    fn curve_of(settings: &[&str], metadata: &Metadata) -> Vec<String> {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let settings: Vec<String> = settings.iter().map(|&text| text.to_owned()).collect();
        let config = tasks::configuration("navigation", None, &settings).unwrap();
        std::fs::write(folder.config_file(), config.to_text()).unwrap();
        assert!(curve(&folder, &config).is_empty(), "it has not begun");
        let options = LogOptions::default();
        LogWriter::create(&folder.log(), metadata, options).unwrap().finish().unwrap();
        curve(&folder, &config)
    }

    #[test]
    fn runs_that_differ_in_more_than_their_seeds_are_no_seeds_of_one_curve() {
        let own = Metadata::new(Kind::Run, "navigation", 1);
        let first = curve_of(&["seed=1"], &own);
        let is_seed = |settings: &[&str], metadata: &Metadata| {
            curve_of(settings, metadata).iter().any(|name| first.contains(name))
        };
        assert!(is_seed(&["seed=2"], &own));
        assert!(is_seed(&["seed=2", "evaluation.episodes=7", "resources.actors=3"], &own));
        let changes =
            ["ppo.clip=0.3", "demonstrations.coverage=0.25", "steps=60000", "method=gaifo"];
        for change in changes {
            assert!(!is_seed(&["seed=2", change], &own), "{change}");
        }
        let of_another_build = own.clone().with("build", "unknown");
        assert!(!is_seed(&["seed=2"], &of_another_build));
    }
}
