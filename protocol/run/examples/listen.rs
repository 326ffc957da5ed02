//! Listens to the trajectories of a run and prints a line for each. The run is being trained, or
//! its log is published again. In two terminals:
//!
//! ```text
//! cargo run --release -p run --example listen -- runs/navigation-0001
//! goalward replay runs/navigation-0001 --publish
//! ```
//!
//! It listens until Ctrl-C. What it receives are whole episodes: [`Trajectory`] has observations,
//! actions and how the episode ended.

use std::error::Error;
use std::io::Write;
use std::time::Duration;

use bus::{Bus, BusAddress, Published};
use protocol::trajectory::{Encoded, Trajectory};
use run::folder::RunFolder;

/// Pause between two polls. `replay --publish` waits for slow readers, and training does not wait at all: poll often.
const PAUSE: Duration = Duration::from_millis(5);

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).ok_or("expected the folder of a run")?;
    let folder = RunFolder::new(folder);
    let spec = folder.config()?.task.spec();
    let bus = Bus::open(&BusAddress::of_run(folder.path())?, "listener")?;
    let subscriber = bus.trajectory_subscriber()?;
    writeln!(std::io::stderr(), "listening to {}", folder.path().display())?;
    loop {
        while let Some(Published { bytes, .. }) = subscriber.receive()? {
            let Trajectory { lane, episode, steps, success, policy_version, .. } =
                Encoded::decode(bytes, &spec)?.trajectory;
            let ending = if success { "reached the goal" } else { "did not reach the goal" };
            writeln!(
                std::io::stdout(),
                "lane {lane} episode {episode}: {steps} steps, {ending}, policy {policy_version}"
            )?;
        }
        std::thread::sleep(PAUSE);
    }
}
