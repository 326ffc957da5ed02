//! Where a verb may write: one rule for everything that `goalward` writes for its user.
//!
//! An existing file is not overwritten without `--force`. Nothing is written into a run's folder under a name that the
//! user chose, not even with `--force`, whatever path leads there.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::Result;
use run::folder::RunFolder;

use terminal::refusal::wrong_usage;

/// Checks that a file may be written at `path`, a name that the user chose.
///
/// # Errors
/// Wrong usage, when the file exists and may not be replaced, lies inside a run, or would be in a missing folder.
pub(crate) fn file(path: &Path, force: bool) -> Result<()> {
    outside_runs(path)?;
    let folder = path.parent().filter(|folder| *folder != Path::new(""));
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        let (shown, folder) = (path.display(), folder.display());
        return Err(wrong_usage(format!("{shown}: expected the folder {folder}, found none")));
    }
    own_file(path, force)
}

/// Checks that a file may be written at `path`, a name in a run's folder that Goalward chose.
///
/// # Errors
/// Wrong usage, when the file exists and may not be replaced.
pub(crate) fn own_file(path: &Path, force: bool) -> Result<()> {
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            Err(wrong_usage(format!("{}: expected a file, found a folder", path.display())))
        }
        Ok(_) if force => Ok(()),
        Ok(_) => Err(taken(path)),
        Err(error) => unless_missing(path, &error),
    }
}

/// Checks that the folder `path`, a name that the user chose, may be filled; an empty folder always may.
///
/// # Errors
/// Wrong usage, when its files may not be replaced, or it lies inside a run.
pub(crate) fn folder(path: &Path, force: bool) -> Result<()> {
    outside_runs(path)?;
    match fs::read_dir(path) {
        Ok(mut entries) => match entries.next() {
            Some(_) if !force => Err(taken(path)),
            _ => Ok(()),
        },
        Err(error) => unless_missing(path, &error),
    }
}

/// Fills the files or folders `places`. If that fails, those that did not exist before are removed, so that the same
/// command can be given again.
///
/// # Errors
/// As `fill`.
pub(crate) fn filled<T>(places: &[&Path], fill: impl FnOnce() -> Result<T>) -> Result<T> {
    let new: Vec<&Path> = places.iter().copied().filter(|place| !place.exists()).collect();
    fill().inspect_err(|_| {
        for place in new {
            // The caller learns why `fill` failed, not that something remains.
            match place.is_dir() {
                true => fs::remove_dir_all(place).ok(),
                false => fs::remove_file(place).ok(),
            };
        }
    })
}

/// Checks that `path` is neither a run's folder nor inside one.
///
/// # Errors
/// Wrong usage, naming the run.
pub(crate) fn outside_runs(path: &Path) -> Result<()> {
    let resolved = resolved(path)?;
    let run = resolved.ancestors().find(|folder| RunFolder::new(*folder).is_run());
    let Some(run) = run else { return Ok(()) };
    let (shown, run) = (path.display(), run.display());
    Err(wrong_usage(format!(
        "{shown}: expected a place outside of runs, found the folder of the run {run}"
    )))
}

/// Returns the place that a path leads to, with links followed; the end of the path need not exist.
///
/// # Errors
/// Wrong usage, when nothing can be created there.
pub(crate) fn resolved(path: &Path) -> Result<PathBuf> {
    let refused = |error: &dyn std::fmt::Display| {
        wrong_usage(format!("{}: expected a place to write to: {error}", path.display()))
    };
    let absolute = std::path::absolute(path).map_err(|error| refused(&error))?;
    for existing in absolute.ancestors() {
        match existing.canonicalize() {
            Ok(canonical) => {
                let rest = absolute.strip_prefix(existing).expect("it is one of its ancestors");
                return Ok(canonical.join(rest));
            }
            Err(_) if existing.is_symlink() => return Err(refused(&"a link that leads nowhere")),
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(refused(&error)),
        }
    }
    Ok(absolute)
}

fn unless_missing(path: &Path, error: &std::io::Error) -> Result<()> {
    match error.kind() {
        ErrorKind::NotFound => Ok(()),
        _ => Err(wrong_usage(format!("{}: {error}", path.display()))),
    }
}

fn taken(path: &Path) -> anyhow::Error {
    let shown = path.display();
    wrong_usage(format!("{shown} exists and is not overwritten (--force replaces it)"))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;
    use run::tasks;

    fn said(result: Result<()>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn what_exists_needs_force() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        fs::write(at("taken"), "dear").unwrap();
        file(&at("free"), false).unwrap();
        assert!(said(file(&at("taken"), false)).contains("not overwritten"));
        file(&at("taken"), true).unwrap();
        assert!(said(file(directory.path(), true)).contains("found a folder"));
        assert!(said(file(&at("missing/free"), true)).contains("expected the folder"));
        assert!(said(file(&at("taken/free"), true)).contains("expected"));

        assert!(said(folder(directory.path(), false)).contains("not overwritten"));
        folder(directory.path(), true).unwrap();
        folder(&at("free/deep"), false).unwrap();
        fs::create_dir(at("empty")).unwrap();
        folder(&at("empty"), false).unwrap();
        assert!(folder(&at("taken"), true).is_err());
    }

    #[test]
    fn what_cannot_be_filled_is_not_left_behind() {
        let directory = tempfile::tempdir().unwrap();
        let [file, folder, old] =
            ["a.csv", "report", "old.csv"].map(|name| directory.path().join(name));
        fs::write(&old, "dear").unwrap();
        let fill = |end: Result<()>| {
            filled(&[&file, &folder, &old], || {
                fs::create_dir(&folder)?;
                fs::write(folder.join("index.html"), "half")?;
                fs::write(&file, "half")?;
                end
            })
        };
        assert_eq!(said(fill(Err(wrong_usage("full")))), "full");
        assert!(!file.exists() && !folder.exists() && old.exists());
        fill(Ok(())).unwrap();
        assert!(file.exists() && folder.exists() && old.exists());
    }

    #[test]
    fn a_run_is_never_written_into() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let run = RunFolder::new(at("run"));
        fs::create_dir_all(run.log()).unwrap();
        folder(run.path(), true).unwrap();
        let config = tasks::configuration("navigation", None, &[]).unwrap();
        fs::write(run.config_file(), config.to_text()).unwrap();
        symlink(run.path(), at("link")).unwrap();
        symlink(run.config_file(), at("file.csv")).unwrap();
        symlink(at("run/new.csv"), at("dangling")).unwrap();
        for inside in ["run/a.csv", "run/config.toml", "run/log/a.csv", "link/a.csv", "file.csv"] {
            assert!(said(file(&at(inside), true)).contains("of the run"), "{inside}");
        }
        assert!(said(file(&at("dangling"), true)).contains("leads nowhere"));
        assert!(said(file(&at("run/log/../a.csv"), true)).contains("of the run"));
        for inside in ["run", "link", "run/deep/er", "link/log"] {
            assert!(said(folder(&at(inside), true)).contains("of the run"), "{inside}");
        }
        file(&at("run.csv"), false).unwrap();

        // A run with a damaged configuration is recognized by its log.
        fs::write(run.config_file(), "?").unwrap();
        fs::write(run.log().join("updates-00000.mcap"), "").unwrap();
        assert!(said(file(&at("run/a.csv"), true)).contains("of the run"));
    }
}
