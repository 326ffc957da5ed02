//! `goalward-actor serve`: serves environments of a task to a program in another language, such as the Python
//! package `goalward`. It is to that program what a Python process is to an actor.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};

use anyhow::{Context, Result};
use environments::{Environment, EnvironmentError};
use protocol::ending::Ending;
use protocol::seed::{Purpose, stream};
use protocol::task::Spec;

use crate::factory::Factory;
use crate::frame::{self, Answer, Failure, Hello, Kind, Request};

/// Serves until the input ends. A request that an environment refuses is answered with a failure frame and
/// changes nothing, but slots before it in the same turn have acted. An environment that fails is reported in
/// the same way, and ends serving.
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
            Err(NoAnswer { failure, ends }) => {
                send(output, Kind::Failed, &serde_json::to_vec(&failure)?)?;
                if ends {
                    return Ok(());
                }
            }
        }
    }
}

fn send(output: &mut impl Write, kind: Kind, body: &[u8]) -> Result<()> {
    frame::write(output, kind, body)?;
    Ok(output.flush()?)
}

/// Why there is no answer, and whether serving ends.
struct NoAnswer {
    failure: Failure,
    ends: bool,
}

impl NoAnswer {
    fn new(slot: u16, during: &str, error: &anyhow::Error) -> NoAnswer {
        let failure = Failure {
            slot,
            during: during.to_owned(),
            error: format!("{error:#}"),
            traceback: String::new(),
        };
        NoAnswer { failure, ends: has_failed(error) }
    }
}

/// Returns whether an environment failed, as opposed to refusing a request.
fn has_failed(error: &anyhow::Error) -> bool {
    use EnvironmentError::{Other, Raised, StateNotFinite};
    let error = error.downcast_ref::<EnvironmentError>();
    matches!(error, Some(StateNotFinite { .. } | Raised(_) | Other(_)))
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
            sources: BTreeMap::new(),
        })
    }

    fn answer(&mut self, kind: Kind, body: &[u8]) -> Result<Vec<u8>, NoAnswer> {
        let mut answers = Vec::new();
        match (kind, body) {
            (Kind::Turn, body) => {
                for (slot, request) in frame::requests(body, self.spec.action.bytes()) {
                    let during = if let Request::Step(_) = request { "step" } else { "reset" };
                    let answer = self.act(slot, request);
                    let answer = answer.map_err(|error| NoAnswer::new(slot, during, &error))?;
                    frame::append_answer(slot, &answer, &mut answers);
                }
            }
            (Kind::Expert, &[low, high]) => {
                let slot = u16::from_le_bytes([low, high]);
                let action = self.demonstrate(slot);
                answers = action.map_err(|error| NoAnswer::new(slot, "expert", &error))?;
            }
            _ => {
                let error = anyhow::anyhow!("expected a turn, or a slot's expert, found {kind:?}");
                return Err(NoAnswer::new(0, "step", &error));
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
        anyhow::ensure!(
            scripted,
            "expected a scripted expert and an episode in which it has not arrived, found none"
        );
        Ok(action)
    }
}

#[cfg(test)]
mod tests {
    use std::iter;

    use environments::{BUILT_IN, Setting};

    use super::*;

    /// Returns the kinds of the frames that answer these frames, which are for slot 0 in NAVIGATION.
    fn answered(asked: &[(Kind, Option<Request<'_>>)]) -> Vec<Kind> {
        let factory = Factory::new(BUILT_IN, "navigation", Setting::default()).unwrap();
        let (mut input, mut output) = (Vec::new(), Vec::new());
        for (kind, request) in asked {
            let mut body = Vec::new();
            match request {
                Some(request) => frame::append(0, *request, 1, &mut body),
                None => body.extend([0, 0]),
            }
            frame::write(&mut input, *kind, &body).unwrap();
        }
        serve(&factory, &mut &*input, &mut output).unwrap();
        let mut frames = &*output;
        iter::from_fn(|| frame::read(&mut frames).ok()).map(|(kind, _)| kind).collect()
    }

    #[test]
    fn serving_goes_on_after_what_is_refused() {
        let turn = |request| (Kind::Turn, Some(request));
        let (expert, reset) = ((Kind::Expert, None), Request::Reset { seed: 1, rebuild: false });
        let (known, unknown) = (turn(Request::Step(&[0])), turn(Request::Step(&[9])));
        assert_eq!(
            answered(&[known, expert, turn(reset), unknown, known, expert]),
            [
                Kind::Hello,
                Kind::Failed,
                Kind::Failed,
                Kind::Turn,
                Kind::Failed,
                Kind::Turn,
                Kind::Expert,
            ]
        );
    }

    #[test]
    fn only_an_environment_that_fails_ends_it() {
        assert!(has_failed(&EnvironmentError::Raised("by nothing".to_owned()).into()));
        assert!(!has_failed(&EnvironmentError::NotRunning.into()));
        assert!(!has_failed(&anyhow::anyhow!("expected a scripted expert, found none")));
    }
}
