//! Demonstrations from handmade files: the setting that a file records takes precedence, and a file
//! that lacks something or contradicts the configuration is refused with a message.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use std::path::PathBuf;

use mcap_log::{FileWriter, Kind, Metadata, Topic};
use protocol::ending::Ending;
use protocol::setting::Setting;
use protocol::task::write_floats;
use protocol::trajectory::{Encoded, Source, Trajectory};
use run::config::RunConfig;
use run::demonstrations::adopt;
use run::folder::RunFolder;
use run::origin::load_demonstrations;
use run::tasks::configuration;

/// Returns a demonstration of FETCH PUSH whose observations, actions and rewards hold the number of their step.
fn demonstration(steps: u32, steps_to_goal: u32, ending: Ending) -> Trajectory {
    let spec = configuration("fetch-push", None, &[]).unwrap().task.spec();
    let numbered = |count: u32, bytes: usize| {
        let mut all = vec![0; count as usize * bytes];
        let numbers = (0..count).flat_map(|step| vec![step as f32; bytes / 4]);
        write_floats(numbers, &mut all);
        all
    };
    Trajectory {
        task: "fetch-push".to_owned(),
        source: Source::Demonstration as i32,
        steps,
        observation_shape: spec.observation.shape(),
        values: numbered(steps + 1, spec.observation.bytes()).into(),
        continuous_actions: numbered(steps, spec.action.bytes()).into(),
        environment_rewards: numbered(steps, 4).into(),
        ending: ending as i32,
        success: true,
        steps_to_goal,
        state_hash: 7,
        ..Trajectory::default()
    }
}

struct Given {
    /// Removed when this is dropped.
    _folder: tempfile::TempDir,
    settings: Vec<String>,
}

impl Given {
    /// Writes these demonstrations to a file, with their setting if it is given, and prepares a run
    /// that learns from it.
    fn new(setting: Option<&str>, trajectories: &[Trajectory]) -> Given {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("given.mcap");
        let mut metadata = Metadata::new(Kind::Demonstrations, "fetch-push", 1);
        if let Some(setting) = setting {
            metadata = metadata.with("setting", setting);
        }
        let mut writer = FileWriter::create(&file, &metadata, &[Topic::Trajectory]).unwrap();
        for (time, trajectory) in (0..).zip(trajectories) {
            writer.trajectory(&Encoded::encode(trajectory.clone()), time).unwrap();
        }
        writer.seal().unwrap();
        let episodes = trajectories.len();
        let settings = vec![
            format!("demonstrations.file={:?}", file.to_string_lossy()),
            format!("demonstrations.episodes={episodes}"),
            "reward.batch=2".to_owned(),
            "environment.action_scale=[]".to_owned(),
        ];
        Given { _folder: folder, settings }
    }

    fn with(mut self, setting: &str) -> Given {
        self.settings.push(setting.to_owned());
        self
    }

    fn config(&self) -> Result<RunConfig, protocol::Error> {
        let config = configuration("fetch-push", None, &self.settings)?;
        adopt(config, &self.settings)
    }

    fn load(&self) -> Result<Vec<Trajectory>, protocol::Error> {
        load_demonstrations(&RunFolder::new(PathBuf::from("none")), &self.config()?)
    }

    fn refusal(&self) -> String {
        let message = self.load().expect_err("to be refused").to_string();
        assert!(message.contains("given.mcap") && !message.contains('\n'), "{message}");
        message
    }
}

/// Records demonstrations in the setting that the task's file has for them.
fn usual(trajectories: &[Trajectory]) -> Given {
    Given::new(Some("{\"coverage\":1.0,\"noise\":1.0}"), trajectories)
}

#[test]
fn what_runs_on_after_the_goal_is_cut_there() {
    let [long, short] = [(60, 25), (12, 12)].map(|(steps, goal)| {
        let ending = if steps == 60 { Ending::Truncated } else { Ending::GoalReached };
        demonstration(steps, goal, ending)
    });
    // If a demonstration does not say at which step it reached the goal, an ending at the goal does.
    let untold = demonstration(9, 0, Ending::GoalReached);
    let given = usual(&[long, short.clone(), untold.clone()]);
    let found = given.load().unwrap();
    // The state hash is that of the final state, which was cut off.
    let expected = Trajectory { state_hash: 0, ..demonstration(25, 25, Ending::GoalReached) };
    assert_eq!(found[0], expected);
    assert_eq!(found[1..], [short, untold]);
}

#[test]
fn what_reaches_the_goal_by_its_last_step_ends_there() {
    let found = usual(&[demonstration(60, 60, Ending::Truncated)]).load().unwrap();
    assert_eq!(found, [demonstration(60, 60, Ending::GoalReached)]);
}

#[test]
fn a_goal_without_its_step_is_refused() {
    let untold = demonstration(60, 0, Ending::Truncated);
    let said = usual(&[demonstration(9, 9, Ending::GoalReached), untold]).refusal();
    assert!(said.contains("demonstration 1: expected the step that reached the goal"), "{said}");
    let said = usual(&[demonstration(9, 10, Ending::GoalReached)]).refusal();
    assert!(
        said.contains("demonstration 0: trajectory: expected steps to the goal 0..=9, found 10"),
        "{said}"
    );
}

#[test]
fn the_setting_of_a_file_decides() {
    let whole = [demonstration(9, 9, Ending::GoalReached)];
    let recorded = |setting| Given::new(Some(setting), &whole);
    let quarter = recorded("{\"coverage\":0.25,\"noise\":1.5}");
    let found = quarter.config().unwrap().demonstrations.environment;
    assert_eq!(found, Setting("coverage = 0.25\nnoise = 1.5".parse().unwrap()));
    quarter.load().unwrap();
    // The user's values agree with the file.
    let said = ["demonstrations.coverage=0.25", "demonstrations.noise=1.5"];
    said.iter().fold(quarter, |given, said| given.with(said)).load().unwrap();

    let full = || recorded("{\"coverage\":1.0,\"noise\":1.0}");
    let refusal = full().with("demonstrations.coverage=0.25").refusal();
    assert!(refusal.contains("demonstrations.coverage = 0.25"), "{refusal}");
    assert!(refusal.contains("found them recorded with 1"), "{refusal}");
    let refusal = full().with("demonstrations.noise=2.0").refusal();
    assert!(refusal.contains("demonstrations.noise = 2"), "{refusal}");
    // An integer equals the same number as a float; the user's value applies to keys that the file lacks.
    recorded("{\"coverage\":1}").with("demonstrations.noise=1.0").load().unwrap();
    // Keys that the task does not set for demonstrations have the value of the agent's environment.
    let refusal = recorded("{\"ranges\":\"one-sided\"}").refusal();
    assert!(refusal.contains("demonstrations.ranges = \"symmetric\""), "{refusal}");
    let one_sided = recorded("{\"ranges\":\"one-sided\"}");
    one_sided.with("demonstrations.ranges=one-sided").load().unwrap();
}

#[test]
fn tables_of_a_setting_are_decided_key_by_key_and_versions_of_packages_not_at_all() {
    let whole = [demonstration(9, 9, Ending::GoalReached)];
    let given = || {
        let recorded =
            "{\"kwargs\":{\"width\":0.5,\"height\":2.0},\"versions\":{\"python\":\"3.12\"}}";
        let given = Given::new(Some(recorded), &whole);
        given.with("environment.versions.python=\"3.13\"").with("environment.kwargs.width=0.5")
    };
    given().with("demonstrations.kwargs.width=0.5").load().unwrap();
    let refusal = given().with("demonstrations.kwargs.width=0.9").refusal();
    assert!(refusal.contains("demonstrations.kwargs = "), "{refusal}");
    assert!(refusal.contains("width = 0.9") && refusal.contains("height = 2.0"), "{refusal}");
}

#[test]
fn a_setting_that_cannot_be_read_is_refused() {
    let whole = [demonstration(9, 9, Ending::GoalReached)];
    for (setting, words) in [
        ("{\"coverage\":", "setting"),
        ("[1.0]", "setting"),
        ("{\"coverage\":1.0,\"wind\":3}", "demonstrations.wind = nothing"),
    ] {
        let refusal = Given::new(Some(setting), &whole).refusal();
        assert!(refusal.contains(words), "{setting}: {refusal}");
    }
}

#[test]
fn a_file_without_a_setting_takes_the_word_of_the_user() {
    let whole = [demonstration(9, 9, Ending::GoalReached)];
    let silent = Given::new(None, &whole);
    let found = silent.config().unwrap();
    assert!(found.demonstrations.environment.0.is_empty());
    assert_eq!(found.demonstration_setting(), found.environment);
    silent.load().unwrap();
    let told = silent.with("demonstrations.coverage=0.5");
    let found = told.config().unwrap().demonstrations.environment;
    assert_eq!(found, Setting("coverage = 0.5".parse().unwrap()));
    told.load().unwrap();
}

#[test]
fn too_few_rows_for_a_batch_are_refused() {
    let whole =
        [demonstration(9, 9, Ending::GoalReached), demonstration(8, 8, Ending::GoalReached)];
    let batch = |rows: u32| usual(&whole).with(&format!("reward.batch={rows}"));
    batch(19).load().unwrap();
    let refusal = batch(20).refusal();
    assert!(refusal.contains("reward.batch = 20"), "{refusal}");
    assert!(refusal.contains("found 19 in 2 demonstrations"), "{refusal}");
    // A discriminator has no row for the last state, in which nobody acts.
    let gail = |rows| batch(rows).with("method=gail").with(&format!("reward.batch={rows}"));
    gail(17).load().unwrap();
    assert!(gail(18).refusal().contains("found 17"));
    // The discriminator that proximity is multiplied by has one.
    batch(19).with("method=proximity-discriminator").load().unwrap();
}

#[test]
fn demonstrations_that_hold_no_order_are_refused_to_ranking() {
    let ranking = |steps| {
        let all = vec![demonstration(steps, steps, Ending::GoalReached); 3];
        usual(&all).with("method=ranking").with("reward.input=state-action")
    };
    ranking(2).load().unwrap();
    let refusal = ranking(1).refusal();
    assert!(refusal.contains("a demonstration with two rows"), "{refusal}");
}

#[test]
fn a_part_without_a_state_is_refused_to_segment_matching() {
    let matching = |segments: u32| {
        let whole = [demonstration(9, 9, Ending::GoalReached)];
        let given = usual(&whole).with("method=segment-matching").with("reward.batch=128");
        given.with(&format!("reward.segments={segments}"))
    };
    matching(10).load().unwrap();
    let refusal = matching(11).refusal();
    assert!(refusal.contains("each of the 11 parts") && refusal.contains("part 11"), "{refusal}");
}
