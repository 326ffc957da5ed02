//! The summary of a finished run, as people read it.

use protocol::{build, weights};
use run::summary::{Seconds, Summary};
use run::time_to_success::TimeToSuccess;

use terminal::numbers;

/// Less time than this, in seconds, is not split into shares.
const SPLIT_FROM_S: f64 = 1e-3;

/// Returns the summary as a table, one row per line.
pub(crate) fn table(summary: &Summary) -> String {
    let evaluation = success(
        summary.evaluation.success_rate,
        summary.evaluation.episodes,
        summary.evaluation.mean_return,
    );
    let steps = format!(
        "{} in {} iterations",
        numbers::count(summary.environment_steps),
        numbers::count(summary.iterations)
    );
    let time = format!(
        "{}, {}, actors: {}; {} of processors",
        numbers::duration(summary.wall_s),
        numbers::rate(summary.steps_per_s),
        summary.actors,
        numbers::duration(summary.processor_s),
    );
    let log = format!(
        "{} in {} files, {} trajectories",
        numbers::bytes(summary.log.bytes),
        numbers::count(summary.log.files),
        numbers::count(summary.log.trajectories)
    );
    let training = match summary.episodes {
        0 => "none: it learned from demonstrations alone".to_owned(),
        _ => rate(summary.success_rate),
    };
    let mut rows = vec![
        ("run", format!("{}, {}, preset {}", summary.task, summary.method, summary.preset)),
        ("seed", summary.seed.to_string()),
        ("success, last 100 training episodes", training),
        ("success, evaluation", evaluation),
        ("environment steps", steps),
        ("episodes", numbers::count(summary.episodes)),
        ("time", time),
    ];
    rows.extend(times_to_success(&summary.time_to_success));
    rows.push(("policy sha256", summary.policy_sha256.clone()));
    if summary.reward_model_sha256 != weights::sha256([]) {
        rows.push(("reward model sha256", summary.reward_model_sha256.clone()));
    }
    rows.extend([("build", build::shown(&summary.builds)), ("log", log)]);
    rows.extend(shares(&summary.seconds));
    numbers::table(&rows)
}

/// Returns a row for each success rate that was reached for good.
pub(crate) fn times_to_success(
    times: &[TimeToSuccess],
) -> impl Iterator<Item = (&'static str, String)> {
    times.iter().map(|time| {
        let text = format!(
            "{}: {}, {} steps, {} of processors",
            numbers::percent(time.success_rate, 0),
            numbers::duration(time.wall_s),
            numbers::count(time.environment_steps),
            numbers::duration(time.processor_s)
        );
        ("time to success", text)
    })
}

/// Formats a success rate, which not every task reports.
fn rate(success_rate: Option<f64>) -> String {
    let known = |rate| numbers::percent(rate, 1);
    success_rate.map_or("not reported by the task".to_owned(), known)
}

/// Formats the result of an evaluation.
pub(crate) fn success(rate: Option<f64>, episodes: u64, mean_return: Option<f64>) -> String {
    if episodes == 0 {
        return "no episodes".to_owned();
    }
    let episodes = numbers::count(episodes);
    let rate = match rate {
        Some(rate) => format!("{} of {episodes} episodes", numbers::percent(rate, 1)),
        None => format!("not reported by the task, {episodes} episodes"),
    };
    let mean_return = mean_return.map(|mean| format!("; mean return {}", numbers::number(mean)));
    rate + &mean_return.unwrap_or_default()
}

/// Returns shares of the wall time of iterations, and shares of the actors' work within the rollouts: a row for each of
/// the two, unless there was no such work.
fn shares(seconds: &Seconds) -> impl Iterator<Item = (&'static str, String)> {
    let share = |part: f64, whole: f64| numbers::percent(part / whole, 1);
    let wall = seconds.rollout + seconds.scoring + seconds.policy_update + seconds.reward_update;
    let work = seconds.environment + seconds.inference + seconds.transport;
    let stages = format!(
        "rollout {}, scoring {}, policy update {}, reward update {}; in parallel: log {}",
        share(seconds.rollout, wall),
        share(seconds.scoring, wall),
        share(seconds.policy_update, wall),
        share(seconds.reward_update, wall),
        share(seconds.log, wall),
    );
    let actors = format!(
        "inference {}, transport {}, environment {} of {} of work",
        share(seconds.inference, work),
        share(seconds.transport, work),
        share(seconds.environment, work),
        numbers::duration(work),
    );
    let rows = [
        (wall, "where the time went since the last start", stages),
        (work, "where its actors' time went", actors),
    ];
    let rows = rows.into_iter().filter(|(whole, ..)| *whole >= SPLIT_FROM_S);
    rows.map(|(_, name, shares)| (name, shares))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{
        "task": "navigation", "method": "goal-proximity", "preset": "paper", "seed": 7,
        "actors": 2, "environment_steps": 1503232, "episodes": 70123, "iterations": 367,
        "success_rate": 0.97, "evaluation": {"episodes": 200, "success_rate": 0.965},
        "wall_s": 251.0, "processor_s": 480.2,
        "time_to_success": [
            {"success_rate": 0.95, "environment_steps": 1204224, "wall_s": 200.5, "processor_s": 380.0}],
        "steps_per_s": 5989.0, "policy_sha256": "ab", "reward_model_sha256": "cd",
        "log": {"files": 3, "trajectories": 70123, "bytes": 43200000},
        "seconds": {"rollout": 20, "environment": 1, "inference": 30, "transport": 1, "log": 2,
            "scoring": 30, "policy_update": 40, "reward_update": 10}
    }"#;

    #[test]
    fn a_summary_becomes_a_table() {
        let table = table(&serde_json::from_str(TEXT).unwrap());
        for part in [
            "97.0 %",
            "96.5 % of 200",
            "1,503,232 in 367",
            "4 min 11 s",
            "8 min 00 s of processors",
            "95 %: 3 min 21 s, 1,204,224 steps, 6 min 20 s of processors",
            "41.2 MiB in 3",
            "scoring 30.0 %, policy update 40.0 %, reward update 10.0 %",
            "unknown build",
        ] {
            assert!(table.contains(part), "expected {part} in\n{table}");
        }
    }

    #[test]
    fn what_a_run_did_not_do_has_no_row() {
        let whole: Summary = serde_json::from_str(TEXT).unwrap();
        let named = ["reward model sha256", "where the time went", "where its actors' time went"];
        let shown = |summary: &Summary| {
            let table = table(summary);
            named.map(|name| table.contains(name))
        };
        assert_eq!(shown(&whole), [true; 3]);
        let seconds = Seconds { log: 0.03, ..Seconds::default() };
        let resumed_at_its_end = Summary { seconds, ..whole.clone() };
        assert_eq!(shown(&resumed_at_its_end), [true, false, false]);
        let seconds = Seconds { policy_update: 3.0, ..seconds };
        let reward_model_sha256 = weights::sha256([]);
        let cloning = Summary { seconds, reward_model_sha256, ..whole };
        assert_eq!(shown(&cloning), [false, true, false]);
    }
}
