//! `goalward-actor serve`: environments of a task for a program in another language, such as the Python
//! package `goalward`. It is to that program what a process of Python is to an actor.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};

use anyhow::{Context, Result};
use environments::Environment;
use protocol::ending::Ending;
use protocol::seed::{Purpose, stream};
use protocol::task::Spec;

use crate::factory::Factory;
use crate::frame::{self, Answer, Failure, Hello, Kind, Request};

/// Serves until the input ends. An environment that fails is told of in a frame, and ends it, too.
///
/// # Errors
/// When the task does not have such a setting, or the other end is gone.
pub(crate) fn serve(
    factory: &Factory,
    input: &mut impl Read,
    output: &mut impl Write,
) -> Result<()> {
    let mut server = Server { factory, spec: factory.make()?.spec(), slots: BTreeMap::new() };
    send(output, Kind::Hello, &serde_json::to_vec(&server.hello()?)?)?;
    loop {
        let (kind, body) = match frame::read(input) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            frame => frame.context("reading a frame")?,
        };
        match server.answer(kind, &body) {
            Ok(answer) => send(output, kind, &answer)?,
            Err(failure) => return send(output, Kind::Failed, &serde_json::to_vec(&failure)?),
        }
    }
}

fn send(output: &mut impl Write, kind: Kind, body: &[u8]) -> Result<()> {
    frame::write(output, kind, body)?;
    Ok(output.flush()?)
}

/// The environments by slot, made when a slot is first used.
struct Server<'a> {
    factory: &'a Factory,
    spec: Spec,
    slots: BTreeMap<u16, Box<dyn Environment>>,
}

impl Server<'_> {
    fn hello(&self) -> Result<Hello> {
        let environment = self.factory.make()?;
        let Spec { observation, action, horizon_steps } = self.spec;
        let success = if environment.tells_success() { "is_success" } else { "none" };
        Ok(Hello {
            observation,
            action,
            horizon_steps: Some(horizon_steps),
            labels: environment.labels(),
            dropped: Vec::new(),
            success: success.to_owned(),
            versions: BTreeMap::from([(
                "goalward".to_owned(),
                env!("CARGO_PKG_VERSION").to_owned(),
            )]),
        })
    }

    fn answer(&mut self, kind: Kind, body: &[u8]) -> Result<Vec<u8>, Failure> {
        let failed = |slot, during: &str, error: anyhow::Error| Failure {
            slot,
            during: during.to_owned(),
            error: format!("{error:#}"),
            traceback: String::new(),
        };
        let mut answers = Vec::new();
        match (kind, body) {
            (Kind::Turn, body) => {
                for (slot, request) in frame::requests(body, self.spec.action.bytes()) {
                    let during = if let Request::Step(_) = request { "step" } else { "reset" };
                    let answer = self.act(slot, request);
                    let answer = answer.map_err(|error| failed(slot, during, error))?;
                    frame::append_answer(slot, &answer, &mut answers);
                }
            }
            (Kind::Expert, &[low, high]) => {
                let slot = u16::from_le_bytes([low, high]);
                answers = self.demonstrate(slot).map_err(|error| failed(slot, "expert", error))?;
            }
            _ => {
                let error = anyhow::anyhow!("expected a turn, or a slot's expert, found {kind:?}");
                return Err(failed(0, "step", error));
            }
        }
        Ok(answers)
    }

    fn slot(&mut self, slot: u16) -> Result<&mut Box<dyn Environment>> {
        if !self.slots.contains_key(&slot) {
            self.slots.insert(slot, self.factory.make()?);
        }
        self.slots.get_mut(&slot).context("it was made")
    }

    fn act(&mut self, slot: u16, request: Request<'_>) -> Result<Answer> {
        let mut answer =
            Answer { observation: vec![0; self.spec.observation.bytes()], ..Answer::default() };
        let environment = self.slot(slot)?;
        match request {
            Request::Reset { seed, .. } => {
                let mut starts = stream(u64::from(seed), Purpose::EvaluationEpisode, 0, 0);
                environment.reset(&mut starts, &mut answer.observation)?;
            }
            Request::Step(action) => {
                let step = environment.step(action, &mut answer.observation)?;
                answer.reward = step.reward;
                answer.success = step.success;
                answer.truncated = step.ending == Some(Ending::Truncated);
                answer.terminated = step.ending.is_some() && !answer.truncated;
            }
        }
        Ok(answer)
    }

    fn demonstrate(&mut self, slot: u16) -> Result<Vec<u8>> {
        let mut action = vec![0; self.spec.action.bytes()];
        let scripted = self.slot(slot)?.expert_action(&mut action)?;
        anyhow::ensure!(scripted, "expected a scripted expert and an episode, found none");
        Ok(action)
    }
}
