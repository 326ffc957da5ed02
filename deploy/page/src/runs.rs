//! The runs in the served folders, the progress of each, and caches of what was read from them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use anyhow::Result;
use run::folder::RunFolder;
use run::overview::Overview;
use run::updates::begun;

use crate::curves::Curves;
use crate::details::Details;
use crate::kept::Kept;
use crate::listed::{List, Listed};
use crate::programs::PagePrograms;
use crate::shown::Shown;

/// Maximum number of runs whose [`Line`] is cached.
const OVERVIEWS_KEPT: usize = 10_000;

/// Maximum number of runs whose curves are cached.
const CURVES_KEPT: usize = 32;

/// Maximum number of error lines that are shown.
const TROUBLE_SHOWN: usize = 10;

/// The runs at some folders, each of which is a run, has runs in it, or is that of an experiment.
pub(crate) struct Runs {
    places: Vec<PathBuf>,
    overviews: Kept<Result<Line, String>>,
    curves: Kept<Arc<Curves>>,
    pub(crate) shown: Shown,
}

/// A run's name in addresses, and its folder.
type Found = (String, PathBuf);

/// When a run was begun, in seconds since 1970, and its overview.
type Line = (u64, Overview);

impl Runs {
    /// Returns the runs in `places`, with nothing read yet.
    pub(crate) fn in_folders(places: Vec<PathBuf>, programs: Box<dyn PagePrograms>) -> Runs {
        let (overviews, curves) = (Kept::of(OVERVIEWS_KEPT), Kept::of(CURVES_KEPT));
        Runs { places, overviews, curves, shown: Shown::new(programs) }
    }

    /// Returns all runs as they are now.
    pub(crate) fn list(&self) -> List {
        let (found, mut trouble) = self.find();
        let mut runs = Vec::new();
        for (id, path) in &found {
            match self.listed(id, path) {
                Ok(listed) => runs.push(listed),
                Err(error) => trouble.push(error),
            }
        }
        runs.sort_by_key(|run| (std::cmp::Reverse(run.begun), run.id.clone()));
        let more = trouble.len().saturating_sub(TROUBLE_SHOWN);
        trouble.truncate(TROUBLE_SHOWN);
        if more > 0 {
            trouble.push(format!("and {more} more"));
        }
        let places: Vec<String> =
            self.places.iter().map(|path| path.display().to_string()).collect();
        List { folder: places.join(", "), runs, trouble }
    }

    /// Returns the folder of a run; `None` if no run has that name.
    pub(crate) fn folder(&self, id: &str) -> Option<RunFolder> {
        let (_, path) = self.find().0.into_iter().find(|(name, _)| name == id)?;
        Some(RunFolder::new(path))
    }

    /// Returns the details of a run.
    ///
    /// # Errors
    /// When its configuration cannot be read.
    pub(crate) fn details(&self, id: &str, folder: &RunFolder) -> Result<Details> {
        let listed = self.listed(id, folder.path()).map_err(anyhow::Error::msg)?;
        Details::of(folder, listed, &self.curves(folder))
    }

    /// Returns the curves of a run.
    pub(crate) fn curves(&self, folder: &RunFolder) -> Arc<Curves> {
        self.curves.get(folder.path(), |folder| Arc::new(Curves::of(folder)))
    }

    /// Returns a run as the list shows it. Remarks on a damaged summary are dropped here; [`Details`] has them.
    fn listed(&self, id: &str, path: &Path) -> Result<Listed, String> {
        let read = |folder: &RunFolder| -> Result<Line, String> {
            let overview = Overview::of(folder, |_| {}).map_err(|error| error.to_string())?;
            Ok((seconds(begun(folder)), overview))
        };
        let (begun, overview) = self.overviews.get(path, read)?;
        Ok(Listed { id: id.to_owned(), begun, overview })
    }

    fn find(&self) -> (Vec<Found>, Vec<String>) {
        let (mut found, mut trouble) = (Vec::new(), Vec::new());
        for place in &self.places {
            match RunFolder::all_at(place) {
                // Others may see the page, so a link does not lead out of the folder.
                Ok(runs) => found.extend(
                    runs.iter()
                        .map(|run| run.path().to_owned())
                        .filter(|run| run == place || !run.is_symlink()),
                ),
                Err(error) => trouble.push(format!("{}: {error}", place.display())),
            }
        }
        (named(found), trouble)
    }
}

/// Names runs after their folders; a name that is already taken gets a number.
fn named(paths: Vec<PathBuf>) -> Vec<Found> {
    let mut found: Vec<Found> = Vec::new();
    for path in paths {
        let full = path.canonicalize().unwrap_or_else(|_| path.clone());
        let own = full.file_name().unwrap_or(full.as_os_str()).to_string_lossy().into_owned();
        let is_taken = |name: &String| found.iter().any(|(known, _)| known == name);
        let numbered = (2..).map(|number| format!("{own}~{number}"));
        let mut names = std::iter::once(own.clone()).chain(numbered);
        let name = names.find(|name| !is_taken(name)).expect("numbers do not end");
        found.push((name, path));
    }
    found
}

/// Returns the seconds from 1970 to `time`; 0 if there is none.
fn seconds(time: Option<SystemTime>) -> u64 {
    let since = time.and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    since.map_or(0, |since| since.as_secs())
}
