//! Remarks on the keys of a configuration: the comments of the file of defaults.

use protocol::task::ObservationSpec;

use super::{DEFAULTS, RunConfig};

impl RunConfig {
    /// Returns the comment of the file of defaults on a key such as `ppo.clip`, in the table that
    /// this task and learner take it from; `None` if there is no comment.
    pub fn remark(&self, key: &str) -> Option<&'static str> {
        let observation = match self.task.observation {
            ObservationSpec::Cells { .. } => "cells",
            ObservationSpec::Vector { .. } => "vector",
        };
        let learner = format!("learners.{}", self.learner.name());
        let places = [format!("{observation}.{key}"), format!("{learner}.{key}"), key.to_owned()];
        places.iter().find_map(|place| remark(place))
    }
}

fn remark(place: &str) -> Option<&'static str> {
    let mut table = "";
    for line in DEFAULTS.lines() {
        let (entry, remark) = line.split_once('#').unwrap_or((line, ""));
        if let Some(name) = entry.trim().strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
            table = name;
        } else if let Some((name, _)) = entry.split_once('=') {
            let (name, remark) = (name.trim(), remark.trim());
            let is_it = match place.rsplit_once('.') {
                Some((of, key)) => (of, key) == (table, name),
                None => table.is_empty() && place == name,
            };
            if is_it && !remark.is_empty() {
                return Some(remark);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use crate::tasks;

    #[test]
    fn a_key_is_explained_where_its_task_and_learner_have_it_from() {
        let config = |task, method: &str| {
            tasks::configuration(task, None, &[format!("method={method}")]).unwrap()
        };
        let grid = config("navigation", "goal-proximity");
        assert_eq!(grid.remark("ppo.gamma"), Some("Table 2"));
        assert_eq!(grid.remark("ppo.epochs"), Some("Table 2"));
        assert_eq!(grid.remark("reward.batch"), Some("Table 3"));
        assert_eq!(grid.remark("seed"), None);
        assert_eq!(grid.remark("no.such"), None);
        let vector = config("fetch-push", "bco");
        assert_eq!(vector.remark("policy.normalize_observations"), Some("the authors' code"));
        assert_eq!(
            vector.remark("cloning.deviations"),
            Some("what the policy does not know it tries")
        );
    }
}
