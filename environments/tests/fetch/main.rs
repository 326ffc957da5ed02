//! The Fetch tasks and their experts compared with the paper and the authors' code: how the gripper responds, how
//! often and how soon the experts succeed, where cubes and goals lie. Everything is judged by observations and poses
//! alone.

mod episodes;
mod experts;
mod gripper;
mod starts;

use environments::fetch::{self, FetchSetting, FetchTask};
use environments::{Environment, Pose, Step};
use protocol::seed::{Purpose, stream};
use protocol::task::{floats, write_floats};

const TASKS: [FetchTask; 2] = [FetchTask::Pick, FetchTask::Push];
/// Half of the cube's side, and the height of the table top.
const CUBE_HALF_EXTENT: f32 = 0.025;
const TABLE_TOP: f32 = 0.4;

type Observation = [f32; 16];

struct Fetch {
    environment: fetch::Fetch,
    bytes: [u8; 64],
}

impl Fetch {
    fn open(task: FetchTask, setting: &FetchSetting) -> Fetch {
        let environment = fetch::Fetch::new(task, setting.clone()).expect("a setting there is");
        Fetch { environment, bytes: [0; 64] }
    }

    fn reset(&mut self, episode: u64) -> Observation {
        let mut starts = stream(1, Purpose::Demonstration, 0, episode);
        self.environment.reset(&mut starts, &mut self.bytes).expect("reset");
        self.observation()
    }

    fn observation(&self) -> Observation {
        let mut observation = [0.0; 16];
        observation.iter_mut().zip(floats(&self.bytes)).for_each(|(to, from)| *to = from);
        observation
    }

    /// Takes a step with as many of the numbers as the task's action has.
    fn step(&mut self, numbers: [f32; 4]) -> (Observation, Step) {
        let mut action = vec![0; self.environment.spec().action.bytes()];
        let len = action.len() / 4;
        write_floats(numbers.into_iter().take(len), &mut action);
        let step = self.environment.step(&action, &mut self.bytes).expect("a valid action");
        (self.observation(), step)
    }

    fn expert(&mut self) -> [f32; 4] {
        let mut action = vec![0; self.environment.spec().action.bytes()];
        assert!(self.environment.expert_action(&mut action).expect("a script does not fail"));
        let mut numbers = [0.0; 4];
        numbers.iter_mut().zip(floats(&action)).for_each(|(to, from)| *to = from);
        numbers
    }

    fn pose(&self, name: &str) -> Pose {
        let solids = self.environment.solids();
        let index = solids.iter().position(|solid| solid.name == name).expect("a solid there is");
        let mut poses = Vec::new();
        self.environment.append_poses(&mut poses);
        assert_eq!(poses.len(), solids.len());
        poses[index]
    }

    /// Returns the fraction of episodes in which the expert succeeds, and the mean number of steps of those episodes.
    fn experts_record(&mut self, episodes: u64) -> (f64, f64) {
        let (mut successes, mut steps) = (0.0, 0.0);
        for episode in 0..episodes {
            self.reset(episode);
            for taken in 1.. {
                let action = self.expert();
                let (_, step) = self.step(action);
                if step.success {
                    successes += 1.0;
                    steps += f64::from(taken);
                }
                if step.ending.is_some() {
                    break;
                }
            }
        }
        (successes / episodes as f64, steps / successes)
    }
}

fn noise(factor: f64) -> FetchSetting {
    FetchSetting { noise: factor, ..FetchSetting::default() }
}

/// Returns the height of the cube's lowest corner above the table top.
fn lowest_corner(cube: &Pose) -> f32 {
    let [x, y, z, w] = cube.orientation;
    // The third row of the rotation matrix: the z components of the cube's axes.
    let rise = [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)];
    let reach: f32 = rise.iter().map(|axis| axis.abs() * CUBE_HALF_EXTENT).sum();
    cube.position[2] - reach - TABLE_TOP
}
