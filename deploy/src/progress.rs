//! The progress of a run, as the learner publishes it (see [`Progress`]): one line that updates itself on a terminal,
//! plain lines now and then in a pipe.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::time::Instant;

use protocol::messages::{Phase, Pretraining, Progress, RewardUpdate};

use crate::output::Output;
use terminal::numbers;
use terminal::status_line::StatusLine;

/// Wall time over which the pace is measured, seconds: several iterations at the usual pace.
const PACE_WINDOW_S: f64 = 20.0;

/// Shows progress and remarks, and can write the remarks to a file, too.
pub(crate) struct ProgressView {
    line: StatusLine,
    kept: Option<Kept>,
    pace: Pace,
    phase: Option<Phase>,
}

impl ProgressView {
    /// Creates a view for a terminal if standard error is one, for a pipe otherwise.
    pub(crate) fn new() -> Self {
        ProgressView { line: StatusLine::new(), kept: None, pace: Pace::default(), phase: None }
    }

    /// Creates a view that also appends its remarks to `output`.
    pub(crate) fn kept_in(output: Output) -> Self {
        let kept = Some(Kept { output, begun: Instant::now() });
        ProgressView { kept, ..ProgressView::new() }
    }

    /// Says what is going on while there is no progress yet.
    pub(crate) fn activity(&mut self, text: &str) {
        self.line.say(text);
    }

    /// Shows the newest progress, with its quantities as in an [`Update`](run::updates::Update); in a pipe only if a
    /// line is due.
    pub(crate) fn show(&mut self, progress: &Progress) {
        let phase = Phase::try_from(progress.phase).unwrap_or(Phase::Training);
        let is_new_phase = self.phase.replace(phase) != Some(phase);
        if is_new_phase && phase == Phase::DiskFull {
            self.note("no room on the disk: the run waits and continues when there is room again");
        }
        let steps = progress.environment_steps();
        if phase != Phase::Pretraining {
            self.pace.add(progress.wall_s, steps);
        }
        let tenth = numbers::percent_done(steps, progress.steps_wanted) / 10;
        self.line.show(&line(progress, self.pace.per_second()), tenth, is_new_phase);
    }

    /// Animates the line between two messages.
    pub(crate) fn tick(&self) {
        self.line.tick();
    }

    /// Prints a remark for people above the line.
    pub(crate) fn note(&self, text: &str) {
        self.line.note(text);
        if let Some(kept) = &self.kept {
            kept.note(text);
        }
    }

    /// Removes the line from the terminal.
    pub(crate) fn finish(&self) {
        self.line.finish();
    }
}

/// The file that remarks are appended to.
struct Kept {
    output: Output,
    begun: Instant,
}

impl Kept {
    fn note(&self, text: &str) {
        let seconds = self.begun.elapsed().as_secs_f64();
        let line = |mut file: File| Ok(writeln!(file, "after {seconds:.1} s: {text}")?);
        if let Err(error) = self.output.open().and_then(line) {
            tracing::debug!("a remark could not be kept: {error:#}");
        }
    }
}

/// Returns the metrics in one line, the most important first, since a narrow terminal cuts off its end. Steps are those
/// learned from.
fn line(progress: &Progress, per_second: f64) -> String {
    let phase = Phase::try_from(progress.phase);
    let Some(update) = &progress.update else {
        let received = numbers::count(progress.steps_received);
        return match phase {
            Ok(Phase::Pretraining) => offline(progress),
            _ if progress.steps_wanted == 0 => "learning from the demonstrations".to_owned(),
            _ => format!("rolling out: {received} steps received"),
        };
    };
    let phase = match phase {
        Ok(Phase::Pretraining) => "waiting for the proximity service  ",
        Ok(Phase::Evaluating) => "evaluating  ",
        Ok(Phase::DiskFull) => "WAITING FOR ROOM ON THE DISK  ",
        Ok(Phase::Finished) => "ending  ",
        Ok(Phase::Training) | Err(_) => "",
    };
    let (done, wanted) = (update.environment_steps, progress.steps_wanted);
    if wanted == 0 {
        return format!(
            "{phase}epoch {} over the demonstrations{}{}",
            numbers::count(update.iteration + 1),
            measured("loss", update.policy_loss),
            measured("held-out loss", update.held_out_loss),
        );
    }
    let seconds_left = wanted.saturating_sub(done) as f64 / per_second;
    let trained = |update: &&RewardUpdate| update.demonstration_loss.is_finite();
    let reward_loss =
        progress.reward_update.as_ref().filter(trained).map_or(String::new(), |update| {
            let (demonstrations, agent) = (update.demonstration_loss, update.agent_loss);
            let (demonstrations, agent) = (numbers::number(demonstrations), numbers::number(agent));
            let steps = numbers::count(update.gradient_steps);
            format!("  reward loss {demonstrations}+{agent} in {steps} gradient steps")
        });
    format!(
        "{phase}{}/{} steps  {} %  success {}  {}  {} left{}{}{reward_loss}  actors {}  leases {}",
        numbers::count(done),
        numbers::count(wanted),
        numbers::percent_done(done, wanted),
        numbers::percent(update.success_rate, 0),
        numbers::rate(per_second),
        numbers::duration(seconds_left),
        measured("KL", update.approximate_kl),
        measured("value loss", update.value_loss),
        progress.actors,
        progress.leases,
    )
}

/// Returns a part of the line; nothing for a quantity that the method does not have.
fn measured(name: &str, number: f64) -> String {
    if number.is_nan() { String::new() } else { format!("  {name} {}", numbers::number(number)) }
}

/// Describes the progress of offline training. There is none before the service has begun it, or if the method has no
/// offline training: then the run waits for the service to be ready.
pub(crate) fn offline(progress: &Progress) -> String {
    let Some(Pretraining { done, total }) = progress.pretraining else {
        return "waiting for the proximity service".to_owned();
    };
    let percent = numbers::percent_done(done, total);
    let [done, total] = [done, total].map(numbers::count);
    format!("training the reward model offline: {done} of {total} gradient steps ({percent} %)")
}

/// The pace of the run in the last seconds.
#[derive(Default)]
struct Pace {
    /// Wall time in seconds and number of steps, one sample per new number of steps, oldest first.
    samples: VecDeque<(f64, u64)>,
}

impl Pace {
    fn add(&mut self, wall_s: f64, steps: u64) {
        let Some(&(last_s, last_steps)) = self.samples.back() else {
            if wall_s.is_finite() {
                self.samples.push_back((wall_s, steps));
            }
            return;
        };
        if steps == last_steps {
            return;
        }
        // A restarted learner goes back to its checkpoint, so earlier samples do not count.
        if steps < last_steps || !(wall_s.is_finite() && wall_s >= last_s) {
            self.samples.clear();
            return self.add(wall_s, steps);
        }
        self.samples.push_back((wall_s, steps));
        while self.samples.get(1).is_some_and(|&(second_s, _)| wall_s - second_s >= PACE_WINDOW_S) {
            self.samples.pop_front();
        }
    }

    /// Returns the steps per second; NaN while too little is known.
    fn per_second(&self) -> f64 {
        let (Some(first), Some(last)) = (self.samples.front(), self.samples.back()) else {
            return f64::NAN;
        };
        let elapsed_s = last.0 - first.0;
        if elapsed_s > 0.0 { (last.1 - first.1) as f64 / elapsed_s } else { f64::NAN }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use protocol::messages::PolicyUpdate;

    use super::*;

    fn progress(done: u64, wanted: u64, number: f64) -> Progress {
        let update = PolicyUpdate {
            environment_steps: done,
            success_rate: number,
            approximate_kl: number,
            value_loss: number,
            ..PolicyUpdate::default()
        };
        let reward_update = RewardUpdate {
            model_version: 1,
            gradient_steps: 64,
            demonstration_loss: number,
            agent_loss: number,
            ..RewardUpdate::default()
        };
        Progress {
            phase: Phase::Training as i32,
            update: Some(update),
            reward_update: Some(reward_update),
            steps_wanted: wanted,
            actors: 2,
            leases: 32,
            ..Progress::default()
        }
    }

    #[test]
    fn the_line_has_every_figure() {
        let line = line(&progress(409_600, 1_500_000, 0.5), 5000.0);
        assert_eq!(
            line,
            "409,600/1,500,000 steps  27 %  success 50 %  5,000 steps/s  3 min 38 s left  \
             KL 0.500  value loss 0.500  reward loss 0.500+0.500 in 64 gradient steps  actors 2  leases 32"
        );
    }

    #[test]
    fn without_environment_steps_it_shows_passes() {
        let mut progress = progress(0, 0, 0.5);
        let update = progress.update.as_mut().unwrap();
        (update.iteration, update.policy_loss, update.held_out_loss) = (11, 0.25, 0.5);
        let expected = "epoch 12 over the demonstrations  loss 0.250  held-out loss 0.500";
        assert_eq!(line(&progress, f64::NAN), expected);
    }

    #[test]
    fn before_the_first_update_it_says_what_is_going_on() {
        let mut progress = Progress::default();
        assert_eq!(line(&progress, f64::NAN), "waiting for the proximity service");
        progress.pretraining = Some(Pretraining { done: 1500, total: 6000 });
        let expected = "training the reward model offline: 1,500 of 6,000 gradient steps (25 %)";
        assert_eq!(line(&progress, f64::NAN), expected);
        progress.phase = Phase::Training as i32;
        assert_eq!(line(&progress, f64::NAN), "learning from the demonstrations");
        (progress.steps_received, progress.steps_wanted) = (1024, 8000);
        assert_eq!(line(&progress, f64::NAN), "rolling out: 1,024 steps received");
    }

    #[test]
    fn the_pace_is_that_of_the_last_seconds() {
        let mut pace = Pace::default();
        assert!(pace.per_second().is_nan());
        for second in 0..100_u64 {
            let steps = if second < 50 { second * 10 } else { 500 + (second - 50) * 1000 };
            pace.add(second as f64, steps);
        }
        assert_eq!(pace.per_second(), 1000.0);
        pace.add(50.0, 900);
        assert!(pace.per_second().is_nan(), "one sample is no pace");
    }

    proptest! {
        #[test]
        fn no_figure_breaks_the_line(
            done: u64,
            wanted: u64,
            number in proptest::num::f64::ANY,
            per_second in proptest::num::f64::ANY,
            phase in -1..7_i32,
        ) {
            let progress = Progress { phase, ..progress(done, wanted, number) };
            let line = line(&progress, per_second);
            prop_assert!(!line.chars().any(char::is_control));
        }

        #[test]
        fn no_sample_breaks_the_pace(
            samples in proptest::collection::vec((proptest::num::f64::ANY, any::<u64>()), 0..20),
        ) {
            let mut pace = Pace::default();
            for (wall_s, steps) in samples {
                pace.add(wall_s, steps);
                let pace = pace.per_second();
                prop_assert!(pace.is_nan() || pace >= 0.0);
            }
        }
    }
}
