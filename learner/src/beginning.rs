//! The start of training: from scratch, or from the newest checkpoint and the log before it.

use anyhow::{Context, Result, anyhow};
use mcap_log::{Batches, Record, log_files, read_run, repair};
use protocol::durable;
use protocol::task::Spec;
use protocol::tensors::Tensors;
use run::config::RunConfig;
use run::folder::{LEARNER_FILE, RunFolder};
use run::process::Final;
use run::{checkpoint, lost};

use crate::algorithm::{self, PolicyLearner};
use crate::state::State;

/// The policy learner and the state that a run starts with: those of its newest checkpoint, or fresh ones.
pub(crate) struct Beginning {
    pub(crate) learner: Box<dyn PolicyLearner>,
    pub(crate) state: State,
}

impl Beginning {
    /// Seals the log that an interrupted run left open, and reads the run's newest checkpoint.
    pub(crate) fn of_run(folder: &RunFolder, config: &RunConfig) -> Result<Beginning> {
        durable::create_folder(&folder.log())?;
        for file in log_files(&folder.log())?.into_iter().filter(|file| file.active) {
            tracing::info!("{}", repair(&file.path)?);
        }
        let mut beginning = Beginning::fresh(folder, config)?;
        let found = checkpoint::settle(folder)?;
        found.remarks().iter().for_each(|remark| tracing::warn!("{remark}"));
        let Some(newest) = found.newest else { return Ok(beginning) };
        let iteration = newest.iteration;
        tracing::info!("continuing after iteration {iteration}");
        beginning
            .restore(&newest.load(LEARNER_FILE)?)
            .map_err(|message| anyhow!(message))
            .with_context(|| format!("checkpoint {}", newest.folder.display()))?;
        if config.learner.replays() {
            remember(folder, config.task.spec(), iteration, &mut *beginning.learner)?;
        }
        Ok(beginning)
    }

    fn fresh(folder: &RunFolder, config: &RunConfig) -> Result<Beginning> {
        let demonstrations = match config.learner.imitates() {
            true => run::origin::load_demonstrations(folder, config)?,
            false => Vec::new(),
        };
        let (learner, policy) = algorithm::create(config, &demonstrations);
        Ok(Beginning { learner, state: State::fresh(policy, &config.rollout) })
    }

    fn restore(&mut self, tensors: &Tensors) -> Result<(), String> {
        self.state.restore(tensors)?;
        self.learner.restore(tensors)
    }
}

/// Gives a learner the batches of the iterations before `iteration`, from the log. The replay buffer of a policy
/// learner is in no checkpoint, because the log has it already.
///
/// Fails with [`Final`] if the log lacks some of them: with other batches the run would have another result.
fn remember(
    folder: &RunFolder,
    spec: Spec,
    iteration: u64,
    learner: &mut dyn PolicyLearner,
) -> Result<()> {
    let records = read_run(&folder.log())?;
    let missing = lost::of_log(folder, &records);
    let lacks = |what: String| {
        let lines: Vec<String> = [what].into_iter().chain(missing.iter().cloned()).collect();
        Final(format!("log {}: {}", folder.log().display(), lines.join("; ")))
    };
    let mut batches = Batches::new(spec);
    let mut learned = 0;
    for entry in records {
        if learned == iteration {
            break;
        }
        match entry?.record {
            Record::Trajectory(bytes) => batches.add(bytes)?,
            Record::PolicyUpdate(update) => {
                if update.iteration != learned {
                    break;
                }
                let batch = batches.take(&update).map_err(|error| lacks(error.to_string()))?;
                learner.remember(&batch);
                learned += 1;
            }
            _ => {}
        }
    }
    if learned == iteration {
        return Ok(());
    }
    let expected = format!("expected updates 0 to {} to learn from again", iteration - 1);
    Err(lacks(format!("{expected}, found no update {learned}")).into())
}

#[cfg(test)]
mod tests {
    use std::fs::{self, OpenOptions};

    use mcap_log::{Kind, LogOptions, LogWriter, Metadata};
    use protocol::messages::{PolicyUpdate, Score};
    use protocol::task::{ActionSpec, ObservationSpec};
    use protocol::trajectory::{Encoded, Trajectory, TrajectoryKey};

    use super::*;
    use crate::algorithm::{Metrics, Schedule};
    use crate::state::PolicyState;

    /// A learner that counts the batches it is given.
    #[derive(Default)]
    struct Counting(u64);

    impl PolicyLearner for Counting {
        fn update(
            &mut self,
            _: &mut PolicyState,
            _: &[Encoded],
            _: &[Score],
            _: &Schedule,
        ) -> Result<Metrics> {
            Ok(Metrics::default())
        }

        fn remember(&mut self, _: &[Encoded]) {
            self.0 += 1;
        }

        fn save(&self, _: &mut Tensors) {}

        fn restore(&mut self, _: &Tensors) -> Result<(), String> {
            Ok(())
        }
    }

    fn log(folder: &RunFolder) -> LogWriter {
        let metadata = Metadata::new(Kind::Run, "navigation", 1);
        LogWriter::create(&folder.log(), &metadata, LogOptions::default()).unwrap()
    }

    /// Appends policy updates with empty batches.
    fn append(log: &mut LogWriter, iterations: &[u64]) {
        for &iteration in iterations {
            let update = PolicyUpdate { iteration, ..PolicyUpdate::default() };
            log.policy_update(&update).unwrap();
        }
        log.flush().unwrap();
    }

    /// Returns how many batches a run remembers that is resumed after four iterations.
    fn remembered(folder: &RunFolder) -> Result<u64> {
        let spec = Spec {
            observation: ObservationSpec::Cells { height: 19, width: 19, classes: 4 },
            action: ActionSpec::Discrete { count: 4 },
            horizon_steps: 100,
        };
        let mut learner = Counting::default();
        remember(folder, spec, 4, &mut learner)?;
        Ok(learner.0)
    }

    fn refusal(folder: &RunFolder) -> String {
        let error = remembered(folder).unwrap_err();
        assert!(error.is::<Final>(), "started again, it comes to the same: {error:#}");
        error.to_string()
    }

    #[test]
    fn all_batches_are_remembered_or_the_first_that_is_missing_is_named() {
        for (updates, missing) in
            [(&[0, 1, 2, 3, 4][..], None), (&[0, 1, 3][..], Some(2)), (&[1, 2, 3][..], Some(0))]
        {
            let home = tempfile::tempdir().unwrap();
            let folder = RunFolder::new(home.path());
            let mut writer = log(&folder);
            append(&mut writer, updates);
            writer.finish().unwrap();
            let Some(missing) = missing else {
                assert_eq!(remembered(&folder).unwrap(), 4);
                continue;
            };
            let refusal = refusal(&folder);
            let words = "expected updates 0 to 3 to learn from again, found no update";
            assert!(refusal.ends_with(&format!("{words} {missing}")), "{refusal}");
        }
    }

    #[test]
    fn what_was_recorded_after_the_checkpoint_is_not_read() {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let mut writer = log(&folder);
        append(&mut writer, &[0, 1, 2, 3]);
        // A trajectory without observations fits no task.
        let misfit = Trajectory { iteration: 4, ..Trajectory::default() };
        writer.trajectory(&Encoded::encode(misfit)).unwrap();
        writer.finish().unwrap();
        assert_eq!(remembered(&folder).unwrap(), 4);
    }

    #[test]
    fn what_a_file_has_lost_is_named_too() {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let file = folder.log().join("updates-00000.mcap");
        let mut writer = log(&folder);
        append(&mut writer, &[0, 1]);
        let kept = fs::metadata(file.with_extension("mcap.active")).unwrap().len();
        append(&mut writer, &[2, 3]);
        writer.finish().unwrap();
        // A file that its writer still holds counts as being written, so nothing of it counts as lost.
        drop(writer);
        assert_eq!(remembered(&folder).unwrap(), 4);
        OpenOptions::new().write(true).open(&file).unwrap().set_len(kept).unwrap();
        let refusal = refusal(&folder);
        for words in ["found no update 2; ", "updates-00000.mcap: cut off"] {
            assert!(refusal.contains(words), "{refusal}");
        }
    }

    #[test]
    fn a_batch_that_the_log_lacks_ends_the_run_with_the_path() {
        let home = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(home.path());
        let mut writer = log(&folder);
        let consumed = vec![TrajectoryKey::default()];
        writer.policy_update(&PolicyUpdate { consumed, ..PolicyUpdate::default() }).unwrap();
        writer.finish().unwrap();
        let refusal = refusal(&folder);
        assert!(
            refusal.contains("iteration 0: expected lane 0 episode 0 of its batch"),
            "{refusal}"
        );
        assert!(refusal.contains(&folder.log().display().to_string()), "{refusal}");
    }
}
