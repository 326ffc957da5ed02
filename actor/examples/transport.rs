//! Measures what it costs to step Python environments from an actor: rounds through the actor and rounds in
//! Python alone alternate, with random actions and a reset after every episode.
//!
//! Usage: `transport ID [COPIES] [STEPS] [ROUNDS]`, for example `transport Ant-v5 16 200 10`. The interpreter
//! is the one that `GOALWARD_PYTHON` names.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::time::Instant;

use actor::{Environment, Setting};
use protocol::seed::{Purpose, Stream, stream};
use protocol::task::{ActionSpec, write_floats};
use rand::RngExt;

/// Environments side by side, like the lanes of an actor.
struct Lanes {
    environments: Vec<Box<dyn Environment>>,
    observation: Vec<u8>,
    actions: Vec<Vec<u8>>,
    chance: Stream,
}

impl Lanes {
    fn new(name: &str, copies: usize) -> Result<Lanes, Box<dyn Error>> {
        let setting = Setting(format!("make = \"gym:{name}\"").parse()?);
        let environments: Vec<_> =
            (0..copies).map(|_| actor::python::make(&setting)).collect::<Result<_, _>>()?;
        let spec = environments[0].spec();
        let mut lanes = Lanes {
            environments,
            observation: vec![0; spec.observation.bytes()],
            actions: vec![vec![0; spec.action.bytes()]; copies],
            chance: stream(1, Purpose::TrainingActions, 0, 0),
        };
        (0..copies).try_for_each(|lane| lanes.reset(lane))?;
        Ok(lanes)
    }

    fn reset(&mut self, lane: usize) -> Result<(), Box<dyn Error>> {
        let mut starts = stream(self.chance.random(), Purpose::TrainingEpisode, lane as u64, 0);
        Ok(self.environments[lane].reset(&mut starts, &mut self.observation)?)
    }

    /// Takes one step in every lane.
    fn step(&mut self) -> Result<(), Box<dyn Error>> {
        let spec = self.environments[0].spec();
        for (environment, action) in self.environments.iter_mut().zip(&mut self.actions) {
            match spec.action {
                ActionSpec::Discrete { count } => {
                    action[0] = self.chance.random_range(0..count) as u8
                }
                ActionSpec::Continuous { len } => {
                    write_floats((0..len).map(|_| self.chance.random_range(-1.0..1.0)), action);
                }
            }
            environment.announce(action)?;
        }
        for lane in 0..self.environments.len() {
            let ended = self.environments[lane]
                .step(&self.actions[lane], &mut self.observation)?
                .ending
                .is_some();
            if ended {
                self.reset(lane)?;
            }
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let name = arguments.first().ok_or("expected the ID of an environment")?;
    let number = |at: usize, default| arguments.get(at).map_or(Ok(default), |text| text.parse());
    let (copies, steps, rounds) = (number(1, 16)?, number(2, 200)?, number(3, 10)?);
    let mut lanes = Lanes::new(name, copies)?;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/alone.py");
    let python = std::env::var("GOALWARD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut alone = Command::new(python)
        .args([script, name, &copies.to_string(), &steps.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut orders = alone.stdin.take().ok_or("a pipe")?;
    let mut times = BufReader::new(alone.stdout.take().ok_or("a pipe")?).lines();
    let (mut own, mut others) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        let begun = Instant::now();
        (0..steps).try_for_each(|_| lanes.step())?;
        own.push(begun.elapsed().as_secs_f64());
        writeln!(orders, "go")?;
        others.push(times.next().ok_or("a time")??.parse::<f64>()?);
    }
    drop(orders);
    alone.wait()?;
    let all = (copies * steps) as f64;
    let micros = |mut seconds: Vec<f64>| {
        seconds.sort_by(f64::total_cmp);
        [seconds[0], seconds[seconds.len() / 2]].map(|seconds| 1e6 * seconds / all)
    };
    let ([own_least, own], [other_least, other]) = (micros(own), micros(others));
    writeln!(
        std::io::stdout(),
        "{name} x {copies}: through the actor {own:.1} us a step (least {own_least:.1}), Python alone \
         {other:.1} (least {other_least:.1}), speed {:.3} of it (least {:.3})",
        other / own,
        other_least / own_least,
    )?;
    Ok(())
}
