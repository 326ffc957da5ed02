//! Runs a physics task for a program in another language. It reads one JSON request per line from standard input and
//! writes one JSON response per line to standard output. `environments/fidelity/` uses it to compare the tasks with
//! MuJoCo, `docs/results/peers_methods.py` to compare methods with those of a Python library.
//!
//! Arguments: the name of the task, and optionally its setting as JSON, as in `fetch-push '{"noise": 0}'`.
//!
//! | request | response |
//! |---|---|
//! | `{"reset": 3}`, with the number of an episode | `{"observation": [...], "ending": null, "success": false}` |
//! | `{"step": [0.5, 0, 0]}`, with an action | the same |
//! | `"expert"` | `{"action": [...]}`, or `{"action": null}` if there is none |
//! | `{"time": 1000}`, with a number of steps | `{"thread_s": 0.2}` |
//!
//! `thread_s` is the processor time of this thread, in seconds, for steps with random actions and a reset at the end
//! of every episode. The actions are drawn before timing starts.

use std::error::Error;
use std::io::{BufRead, Write};

use environments::{Environment, Setting, create};
use protocol::ending::Ending;
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, ObservationSpec, Spec, floats, write_floats};
use rand::RngExt;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// The seed of all episodes.
const SEED: u64 = 1;

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Request {
    Reset(u64),
    Step(Vec<f32>),
    Expert,
    Time(u32),
}

#[derive(Serialize)]
#[serde(untagged)]
enum Answer {
    State { observation: Vec<f32>, ending: Option<&'static str>, success: bool },
    Expert { action: Option<Vec<f32>> },
    Time { thread_s: f64 },
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let task = arguments.next().ok_or("expected the name of a task")?;
    let setting: Setting = match arguments.next() {
        Some(json) => serde_json::from_str(&json)?,
        None => Setting::default(),
    };
    let mut environment = create(&task, &setting)?;
    let Spec { observation, action, .. } = environment.spec();
    let has_numbers = matches!(observation, ObservationSpec::Vector { .. })
        && matches!(action, ActionSpec::Continuous { .. });
    if !has_numbers {
        return Err(format!("expected a task of numbers, found {task}").into());
    }
    let mut answers = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let answer = answer(&mut *environment, serde_json::from_str(&line?)?)?;
        writeln!(answers, "{}", serde_json::to_string(&answer)?)?;
        answers.flush()?;
    }
    Ok(())
}

fn answer(environment: &mut dyn Environment, request: Request) -> Result<Answer, Box<dyn Error>> {
    let spec = environment.spec();
    let mut observation = vec![0; spec.observation.bytes()];
    Ok(match request {
        Request::Reset(episode) => {
            environment.reset(&mut start(episode), &mut observation)?;
            Answer::State {
                observation: floats(&observation).collect(),
                ending: None,
                success: false,
            }
        }
        Request::Step(numbers) => {
            let mut action = vec![0; 4 * numbers.len()];
            write_floats(numbers, &mut action);
            let step = environment.step(&action, &mut observation)?;
            let ending = step.ending.map(|ending| match ending {
                Ending::GoalReached => "goal reached",
                Ending::Failed => "failed",
                Ending::Truncated => "truncated",
            });
            Answer::State {
                observation: floats(&observation).collect(),
                ending,
                success: step.success,
            }
        }
        Request::Expert => {
            let mut action = vec![0; spec.action.bytes()];
            let found = environment.expert_action(&mut action)?;
            Answer::Expert { action: found.then(|| floats(&action).collect()) }
        }
        Request::Time(steps) => Answer::Time { thread_s: time_s(environment, steps)? },
    })
}

/// Returns the seconds that this thread spends on random steps.
fn time_s(environment: &mut dyn Environment, steps: u32) -> Result<f64, Box<dyn Error>> {
    let spec = environment.spec();
    let (mut observation, width) = (vec![0; spec.observation.bytes()], spec.action.bytes());
    let mut actions = vec![0; width * steps as usize];
    let mut draws = stream(SEED, Purpose::TrainingActions, 0, 0);
    write_floats((0..actions.len() / 4).map(|_| draws.random_range(-1.0f32..1.0)), &mut actions);
    let mut episode = 0;
    environment.reset(&mut start(episode), &mut observation)?;
    let begun_s = thread_s();
    for action in actions.chunks_exact(width) {
        if environment.step(action, &mut observation)?.ending.is_some() {
            episode += 1;
            environment.reset(&mut start(episode), &mut observation)?;
        }
    }
    Ok(thread_s() - begun_s)
}

fn start(episode: u64) -> Stream {
    stream(SEED, Purpose::Demonstration, 0, episode)
}

fn thread_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
