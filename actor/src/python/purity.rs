//! Tests whether a Python environment is a pure function of its seed and its actions, by running the same
//! episode again, after another one, beside another one, and in another process.

use environments::{Environment, EnvironmentError, Setting};
use protocol::seed::{Purpose, Stream, stream};
use protocol::setting::MAKE;
use protocol::task::{ActionSpec, write_floats};
use rand::RngExt;

use super::environment::{PythonSetting, Slot};
use super::link::Link;

/// Number of steps of an episode that are compared.
const STEPS: u32 = 50;

/// Returns a setting as it has to be so that episodes can be re-simulated, and whether they can. A setting
/// without Python is returned unchanged.
///
/// # Errors
/// When the environment cannot be made, or fails.
pub fn purified(setting: Setting) -> Result<(Setting, bool), EnvironmentError> {
    if !setting.0.contains_key(MAKE) {
        return Ok((setting, true));
    }
    let own: PythonSetting = setting.read()?;
    Ok(match Purity::of(&own)? {
        Purity::Pure => (setting, true),
        Purity::PureWhenRebuilt => {
            let make = &own.make;
            tracing::warn!(
                "{make} carries state over into its next episode: setting environment.rebuild=true"
            );
            (Setting::of(&PythonSetting { rebuild: true, ..own }), true)
        }
        Purity::Impure => {
            tracing::warn!("{}: a repeated episode gives a different result", own.make);
            (setting, false)
        }
    })
}

/// How reproducible the episodes of an environment are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purity {
    /// An episode depends on its seed and its actions alone.
    Pure,
    /// The same, if every episode gets a new environment.
    PureWhenRebuilt,
    /// The same episode comes out differently.
    Impure,
}

impl Purity {
    /// Tests the environment of a setting.
    ///
    /// # Errors
    /// When it cannot be made, or fails.
    fn of(setting: &PythonSetting) -> Result<Purity, EnvironmentError> {
        let rebuilt = PythonSetting { rebuild: true, ..setting.clone() };
        if is_pure(setting)? {
            return Ok(Purity::Pure);
        }
        let helps = !setting.rebuild && is_pure(&rebuilt)?;
        Ok(if helps { Purity::PureWhenRebuilt } else { Purity::Impure })
    }
}

fn is_pure(setting: &PythonSetting) -> Result<bool, EnvironmentError> {
    let mut slot = Slot::new(setting.clone())?;
    let first = play(&mut slot, 0)?;
    let other = play(&mut slot, 1)?;
    if play(&mut slot, 0)? != first || play(&mut slot, 1)? != other {
        return Ok(false);
    }
    // Lanes share a process, and with it the process's global random number generators.
    let mut beside = slot.another()?;
    if play_beside(&mut slot, &mut beside)? != [first, other] {
        return Ok(false);
    }
    let mut elsewhere = Slot::on(Link::start(&setting.options())?, setting.clone())?;
    Ok(play(&mut elsewhere, 1)? == other && play(&mut elsewhere, 0)? == first)
}

/// Runs an episode and returns its hash.
fn play(slot: &mut Slot, episode: u64) -> Result<u64, EnvironmentError> {
    let mut acted = Acted::begin(slot, episode)?;
    while acted.step()? {}
    Ok(acted.slot.state_hash())
}

/// Runs the episodes 0 and 1, with their steps interleaved, and returns their hashes.
fn play_beside(slot: &mut Slot, beside: &mut Slot) -> Result<[u64; 2], EnvironmentError> {
    let mut acted = [Acted::begin(slot, 0)?, Acted::begin(beside, 1)?];
    while acted[0].step()? | acted[1].step()? {}
    Ok(acted.map(|acted| acted.slot.state_hash()))
}

/// An episode with random actions.
struct Acted<'slot> {
    slot: &'slot mut Slot,
    chance: Stream,
    steps_left: u32,
}

impl Acted<'_> {
    fn begin(slot: &mut Slot, episode: u64) -> Result<Acted<'_>, EnvironmentError> {
        let mut observation = vec![0; slot.spec().observation.bytes()];
        slot.reset(&mut stream(1, Purpose::TrainingEpisode, 0, episode), &mut observation)?;
        let chance = stream(1, Purpose::TrainingActions, 0, episode);
        Ok(Acted { slot, chance, steps_left: STEPS })
    }

    /// Takes a step, if one is left; returns whether another one follows.
    fn step(&mut self) -> Result<bool, EnvironmentError> {
        if self.steps_left == 0 {
            return Ok(false);
        }
        let spec = self.slot.spec();
        let mut action = vec![0; spec.action.bytes()];
        match spec.action {
            ActionSpec::Discrete { count } => action[0] = self.chance.random_range(0..count) as u8,
            ActionSpec::Continuous { len } => {
                write_floats((0..len).map(|_| self.chance.random_range(-1.0..1.0)), &mut action);
            }
        }
        let mut observation = vec![0; spec.observation.bytes()];
        let ended = self.slot.step(&action, &mut observation)?.ending.is_some();
        self.steps_left = if ended { 0 } else { self.steps_left - 1 };
        Ok(self.steps_left > 0)
    }
}
