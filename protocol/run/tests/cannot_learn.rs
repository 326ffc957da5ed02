//! Configurations that cannot learn, or set keys that the run does not read: each is refused with
//! the values that contradict each other. Unread keys in a task's file or a method are not refused.

use protocol::Error;
use run::config::RunConfig;
use run::tasks::{configuration, of_text};

const TASKS: [&str; 4] = ["navigation", "fetch-pick", "fetch-push", "ant-reach"];

/// Assembles the configuration of a task with settings that are separated by spaces.
fn assemble(task: &str, settings: &str) -> Result<RunConfig, Error> {
    let settings: Vec<String> = settings.split_whitespace().map(str::to_owned).collect();
    configuration(task, None, &settings)
}

/// Checks cases of settings and words of the refusal; without words, the settings must be accepted.
fn judge(task: &str, cases: &[(&str, &[&str])]) {
    for (settings, words) in cases {
        match assemble(task, settings) {
            Ok(_) => assert!(words.is_empty(), "{task} {settings}: expected a refusal"),
            Err(error) => {
                let said = error.to_string();
                assert!(!words.is_empty(), "{task} {settings}: {said}");
                assert!(!said.contains('\n'), "{task} {settings}: one line, found {said}");
                for word in *words {
                    assert!(said.contains(word), "{task} {settings}: expected `{word}` in {said}");
                }
            }
        }
    }
}

#[test]
fn layers_have_a_width() {
    judge(
        "navigation",
        &[
            ("reward.hidden=[0]", &["`reward.hidden`", "at least 1", "[0]"]),
            ("reward.hidden=[64,0,64]", &["`reward.hidden`", "[64, 0, 64]"]),
            ("reward.hidden=[]", &[]),
            ("reward.features=0", &["`reward.features`", "found 0"]),
            ("policy.features=0", &["`policy.features`", "found 0"]),
            ("policy.convolution_channels=[0,0,0]", &["`policy.convolution_channels`"]),
            ("reward.convolution_channels=[16,0,64]", &["`reward.convolution_channels`"]),
            ("method=bco inverse_dynamics.features=0", &["`inverse_dynamics.features`"]),
            (
                "method=bco inverse_dynamics.convolution_channels=[0,1,1]",
                &["`inverse_dynamics.convolution_channels`"],
            ),
        ],
    );
    judge(
        "fetch-push",
        &[
            ("policy.hidden=[0]", &["`policy.hidden`", "[0]"]),
            ("method=bco inverse_dynamics.hidden=[0]", &["`inverse_dynamics.hidden`"]),
            ("method=sqil sqil.hidden=[0,8]", &["`sqil.hidden`"]),
        ],
    );
}

#[test]
fn convolutions_fit_the_grid() {
    judge(
        "navigation",
        &[
            ("policy.convolution_channels=[]", &["`policy.convolution_channels`", "at least one"]),
            ("policy.pool=0", &["`policy.pool`", "1 to 16", "found 0"]),
            ("reward.pool=17", &["`reward.pool`", "found 17"]),
            ("reward.convolution_kernel=0", &["`reward.convolution_kernel`", "found 0"]),
            (
                "policy.convolution_kernel=6",
                &["`policy.convolution_kernel`", "3 convolutions", "19 x 19"],
            ),
            ("policy.convolution_kernel=9223372036854775807", &["`policy.convolution_kernel`"]),
            ("method=bco inverse_dynamics.pool=10", &["`inverse_dynamics.convolution_kernel`"]),
            ("policy.convolution_kernel=3 policy.pool=3 reward.pool=1", &[]),
            ("policy.convolution_kernel=19 policy.pool=1 policy.convolution_channels=[8]", &[]),
        ],
    );
}

#[test]
fn convolutions_of_a_reward_model_fit_the_grid_where_it_trains() {
    let maze = "[task]\nname = \"maze\"\naction.discrete.count = 4\nhorizon_steps = 20\n\
                observation.cells = { height = 5, width = 5, classes = 3 }\n";
    let judged = |method: &str, settings: &[&str]| {
        let method = format!("method={method}");
        let own = [method.as_str(), "policy.convolution_channels=[8]", "policy.pool=1"];
        let settings = own.iter().chain(settings);
        let settings: Vec<String> = settings.map(|&setting| setting.to_owned()).collect();
        of_text(maze, "maze", None, &settings)
    };
    for method in ["environment-reward", "nearest-state", "segment-matching", "bc", "sqil"] {
        judged(method, &[]).unwrap();
    }
    let inverse = ["inverse_dynamics.convolution_channels=[8]", "inverse_dynamics.pool=1"];
    judged("bco", &inverse).unwrap();
    let said = judged("goal-proximity", &[]).unwrap_err().to_string();
    assert!(said.contains("`reward.convolution_kernel`") && said.contains("5 x 5"), "{said}");
}

#[test]
fn the_ensemble_gets_what_it_trains_on() {
    judge(
        "navigation",
        &[
            (
                "reward.samples=128 reward.experience=100",
                &["`reward.samples`", "reward.experience = 100", "found 128"],
            ),
            ("reward.samples=128 reward.experience=128", &[]),
            ("method=gaifo-s reward.experience=4095", &["`reward.samples`", "4095", "4096"]),
            (
                "reward.samples=0 reward.pretraining_epochs=0",
                &["`reward.samples`", "reward.pretraining_epochs = 0", "found 0"],
            ),
            ("method=no-online", &[]),
            ("method=no-offline", &[]),
            ("method=gaifo-s reward.samples=0", &["`reward.samples`", "discriminator"]),
            (
                "demonstrations.episodes=1 reward.samples=128 reward.batch=102",
                &["`reward.batch`", "101", "found 102"],
            ),
            (
                "method=proximity-with-actions demonstrations.episodes=1 reward.samples=128 reward.batch=101",
                &["`reward.batch`", "100", "found 101"],
            ),
            (
                "method=temporal-distance reward.pretraining_epochs=0",
                &["`reward.pretraining_epochs`", "at least 1 with temporal-distance", "found 0"],
            ),
        ],
    );
    judge(
        "fetch-pick",
        &[
            ("reward.batch=2048", &["`reward.samples`", "reward.batch = 2048", "found 1024"]),
            // Without samples, any batch is allowed.
            ("reward.batch=2048 reward.samples=0", &[]),
            ("method=temporal-distance reward.batch=2048", &[]),
        ],
    );
    judge(
        "fetch-push",
        &[
            ("method=segment-matching reward.segments=61", &[]),
            (
                "method=segment-matching reward.segments=100",
                &["`reward.segments`", "at most 61", "found 100"],
            ),
        ],
    );
}

#[test]
fn labels_tell_near_from_far() {
    let both = |settings: &str, words: &[&str]| {
        for task in TASKS {
            judge(task, &[(settings, words)]);
        }
    };
    both("reward.delta=1", &["`reward.delta`", "exponential", "found 1"]);
    both("reward.discounting=exponential reward.delta=0.05", &["`reward.delta`"]);
    both("reward.discounting=exponential reward.delta=0.999", &[]);
    both("reward.discounting=linear reward.delta=0.95", &["`reward.delta`", "linear", "0.95"]);
    both("reward.discounting=linear reward.delta=0.5", &["`reward.delta`"]);
    both("reward.discounting=linear reward.delta=0.1", &[]);
    both("reward.discounting=linear reward.delta=0.005", &[]);
    both("reward.discounting=linear reward.delta=1e-6", &["`reward.delta`", "0.000001"]);
    // The file's exponential delta with linear discounting.
    judge("navigation", &[("reward.discounting=linear", &["`reward.delta`", "0.95"])]);
}

#[test]
fn numbers_move_weights_and_fit_them() {
    judge(
        "navigation",
        &[
            ("ppo.learning_rate=1e-300", &["`ppo.learning_rate`", "between 1e-9 and 1e30"]),
            ("ppo.learning_rate=1e308", &["`ppo.learning_rate`"]),
            ("ppo.learning_rate=0.5", &[]),
            ("ppo.adam_epsilon=1e308", &["`ppo.adam_epsilon`"]),
            ("ppo.max_gradient_norm=1e-300", &["`ppo.max_gradient_norm`"]),
            ("ppo.clip=1e-300", &["`ppo.clip`"]),
            ("ppo.value_clip=1e308", &["`ppo.value_clip`"]),
            ("ppo.value_clip=0", &[]),
            ("ppo.value_coefficient=1e308", &["`ppo.value_coefficient`"]),
            ("ppo.entropy_coefficient=1e308", &["`ppo.entropy_coefficient`"]),
            ("reward.learning_rate=1e308", &["`reward.learning_rate`"]),
            ("reward.uncertainty=1e308", &["`reward.uncertainty`"]),
            ("method=bc cloning.learning_rate=1e-300", &["`cloning.learning_rate`"]),
            (
                "method=bco inverse_dynamics.learning_rate=1e40",
                &["`inverse_dynamics.learning_rate`"],
            ),
            ("method=sqil sqil.temperature=1e-300", &["`sqil.temperature`"]),
        ],
    );
}

#[test]
fn no_minibatch_can_be_empty() {
    judge(
        "navigation",
        &[
            (
                "rollout.lanes=1 rollout.lane_steps=100",
                &["`ppo.minibatches`", "1 steps", "rollout.lanes = 1", "found 16"],
            ),
            ("rollout.lanes=4 rollout.lane_steps=100 ppo.minibatches=4", &[]),
            ("rollout.lanes=4 rollout.lane_steps=100 ppo.minibatches=5", &["`ppo.minibatches`"]),
            ("rollout.lanes=1 rollout.lane_steps=115", &[]),
            (
                "ppo.minibatches=2049",
                &["`ppo.minibatches`", "at most 2048, half the steps", "2049"],
            ),
            // A learner that makes no minibatches of a rollout allows the shortest.
            ("method=sqil rollout.lanes=1 rollout.lane_steps=100", &[]),
        ],
    );
    judge("fetch-push", &[("method=sqil rollout.lanes=1", &[])]);
}

#[test]
fn a_learner_comes_to_its_first_update() {
    judge(
        "navigation",
        &[
            ("method=sqil steps=5000", &["`sqil.exploration_steps`", "steps = 5000", "found 5000"]),
            ("method=sqil steps=5004", &[]),
            ("method=bco steps=9999", &["`inverse_dynamics.exploration_steps`", "9999", "10000"]),
            ("method=bco steps=10000", &[]),
            ("method=bc reward.model=proximity", &["`reward.model`", "none", "bc"]),
            ("method=bco reward.model=discriminator reward.form=airl", &["`reward.model`", "bco"]),
            ("method=sqil reward.model=environment", &["`reward.model`", "sqil"]),
        ],
    );
    judge(
        "fetch-push",
        &[(
            "method=sqil policy.distribution=gaussian",
            &["`policy.distribution`", "squashed-gaussian", "sqil"],
        )],
    );
}

#[test]
fn deviations_of_squashed_numbers_are_fitted() {
    let refusal: &[&str] = &["`cloning.deviations`", "true", "squashed-gaussian", "found false"];
    judge(
        "fetch-pick",
        &[
            ("method=bc policy.distribution=squashed-gaussian", refusal),
            ("method=bc policy.distribution=squashed-gaussian cloning.deviations=true", &[]),
            ("method=bco policy.distribution=squashed-gaussian", &[]),
            ("method=bco policy.distribution=squashed-gaussian cloning.deviations=false", refusal),
        ],
    );
}

#[test]
fn a_name_is_no_setting() {
    judge(
        "navigation",
        &[
            ("preset=paper", &["--set preset=paper", "--preset paper"]),
            ("preset=goalward", &["--preset goalward"]),
            ("task=fetch-pick", &["--set task=fetch-pick", "goalward train fetch-pick"]),
        ],
    );
    let config = assemble("navigation", "").unwrap();
    let relabeled = config.with_settings(&["preset=paper".to_owned()]);
    assert!(relabeled.unwrap_err().to_string().contains("--preset paper"));
}

const OUT: &str = "left out";

#[test]
fn what_nobody_reads_is_refused_unless_it_is_the_files() {
    judge(
        "navigation",
        &[
            ("policy.hidden=[8]", &["`policy.hidden`", OUT, "grid", "[8]"]),
            ("policy.hidden=[]", &[]),
            ("policy.activation=relu", &["`policy.activation`", OUT]),
            ("policy.distribution=squashed-gaussian", &["`policy.distribution`", OUT]),
            ("cloning.batch=3", &["`cloning.batch`", OUT, "ppo"]),
            ("sqil.batch=3", &["`sqil.batch`", OUT]),
            ("inverse_dynamics.batch=3", &["`inverse_dynamics.batch`", OUT]),
            ("method=bc ppo.clip=0.3", &["`ppo.clip`", OUT, "bc"]),
            ("method=bc ppo.clip=0.2", &[]),
            ("method=bc reward.ensemble=7", &["`reward.ensemble`", OUT]),
            ("method=bc rollout.lag=1", &["`rollout.lag`", OUT, "no environment steps"]),
            ("method=bc rollout.lane_steps=200", &["`rollout.lane_steps`", OUT]),
            ("method=bc rollout.lanes=9", &[]),
            ("method=bc cloning.patience=3", &[]),
            (
                "method=bc cloning.patience=3 cloning.validation=0",
                &["`cloning.patience`", OUT, "cloning.validation = 0 holds out none"],
            ),
            (
                "method=bc cloning.patience=3 demonstrations.episodes=4",
                &["`cloning.patience`", OUT, "cloning.validation = 0.2 holds out none of 4"],
            ),
            ("method=bc cloning.patience=3 demonstrations.episodes=5", &[]),
            ("method=bc demonstrations.episodes=4", &[]),
            ("method=bc cloning.deviations=true", &["`cloning.deviations`", OUT, "discrete"]),
            ("method=bco cloning.patience=3", &["`cloning.patience`", OUT, "bco"]),
            ("method=bco inverse_dynamics.hidden=[8]", &["`inverse_dynamics.hidden`", OUT]),
            ("method=sqil ppo.max_gradient_norm=0.1", &[]),
            ("method=sqil ppo.clip=0.1", &["`ppo.clip`", OUT]),
            ("method=sqil sqil.hidden=[8]", &["`sqil.hidden`", OUT]),
            ("method=sqil sqil.tune_temperature=true", &["`sqil.tune_temperature`", OUT]),
            ("method=environment-reward reward.delta=0.9", &["`reward.delta`", OUT]),
            ("method=environment-reward demonstrations.file=x", &["`demonstrations.file`", OUT]),
            ("method=environment-reward demonstrations.coverage=0.25", &[]),
            ("method=gail reward.discounting=linear", &["`reward.discounting`", OUT]),
            ("method=gail reward.pretraining_epochs=3", &["`reward.pretraining_epochs`", OUT]),
            ("method=gail reward.final_bonus=true", &["`reward.final_bonus`", OUT]),
            ("reward.decay_steps=9", &["`reward.decay_steps`", OUT]),
            ("reward.decay_steps=9 reward.learning_rate_decay=true", &[]),
            ("ppo.decay_steps=9 ppo.learning_rate_decay=false", &["`ppo.decay_steps`", OUT]),
        ],
    );
    judge(
        "ant-reach",
        &[
            ("policy.shared_trunk=true", &["`policy.shared_trunk`", OUT]),
            ("policy.features=8", &["`policy.features`", OUT]),
            ("policy.convolution_channels=[1,2,3]", &["`policy.convolution_channels`", OUT]),
            ("reward.convolution_channels=[1,2,3]", &["`reward.convolution_channels`", OUT]),
            ("reward.features=8", &["`reward.features`", OUT]),
            ("policy.pool=3", &["`policy.pool`", OUT]),
            ("reward.convolution_kernel=3", &["`reward.convolution_kernel`", OUT]),
            ("policy.hidden=[8]", &[]),
            ("method=bco inverse_dynamics.features=8", &["`inverse_dynamics.features`", OUT]),
            ("method=sqil ppo.max_gradient_norm=0.1", &["`ppo.max_gradient_norm`", OUT]),
            ("method=sqil sqil.hidden=[8]", &[]),
            ("method=sqil sqil.tune_temperature=false", &[]),
        ],
    );
}

#[test]
fn tables_of_other_learners_in_a_task_s_file_are_not_judged() {
    let own = "[task]\nname = \"cart\"\nobservation.vector.len = 4\n\
               action.discrete.count = 2\nhorizon_steps = 80\n[inverse_dynamics]\nbatch = 0\n";
    for method in ["goal-proximity", "bc", "sqil", "environment-reward"] {
        let config = of_text(own, "cart", None, &[format!("method={method}")]).unwrap();
        assert!(config.inverse_dynamics.is_none(), "{method}");
    }
    let said = of_text(own, "cart", None, &["method=bco".to_owned()]).unwrap_err().to_string();
    assert!(said.contains("`inverse_dynamics.batch` must be at least 1"), "{said}");
}

/// Assembles the configuration of a small task, whose file has `more` lines, with a setting.
fn line(more: &str, setting: &str) -> Result<RunConfig, Error> {
    let own = "[task]\nname = \"line\"\nobservation.vector.len = 2\naction.discrete.count = 2\n";
    of_text(&format!("{own}{more}"), "line", None, &[setting.to_owned()])
}

#[test]
fn lanes_hold_the_longest_episode_where_somebody_acts() {
    line("horizon_steps = 200\n", "method=bc").unwrap();
    let said = line("horizon_steps = 200\n", "method=goal-proximity").unwrap_err().to_string();
    assert!(said.contains("`rollout.lane_steps` must be at least the longest episode"), "{said}");
}

#[test]
fn what_is_seen_after_the_goal_is_refused_where_nobody_tells_of_it() {
    let judged = |more| line(more, "reward.experience_after_goal=true");
    judged("horizon_steps = 80\n").unwrap();
    let said = judged("horizon_steps = 80\ntells_success = false\n").unwrap_err().to_string();
    assert!(said.contains("`reward.experience_after_goal`") && said.contains(OUT), "{said}");
}

#[test]
fn what_a_reward_model_does_not_read_is_refused() {
    judge(
        "navigation",
        &[
            ("method=ranking reward.delta=0.9", &["`reward.delta`", OUT, "ranking"]),
            ("method=ranking reward.pretraining_epochs=3", &[]),
            ("method=temporal-distance reward.delta=0.9", &[]),
            (
                "method=temporal-distance reward.samples=64",
                &["`reward.samples`", OUT, "temporal-distance"],
            ),
            ("method=temporal-distance reward.agent_weight=0.5", &["`reward.agent_weight`", OUT]),
            ("method=temporal-distance reward.final_bonus=true", &["`reward.final_bonus`", OUT]),
            ("method=temporal-distance reward.form=absolute", &["`reward.form`", "difference"]),
            (
                "method=temporal-distance reward.learning_rate_decay=true",
                &["`reward.learning_rate_decay`", OUT, "temporal-distance"],
            ),
            ("method=proximity-discriminator reward.form=absolute", &[]),
            ("method=proximity-discriminator reward.samples=0", &["`reward.samples`", "above 0"]),
            (
                "method=proximity-discriminator reward.input=state-action",
                &["`reward.input`", "state"],
            ),
            ("method=segment-matching reward.segments=1", &[]),
            ("method=segment-matching reward.segments=0", &["`reward.segments`", "from 1"]),
            ("reward.segments=2", &["`reward.segments`", OUT]),
        ],
    );
}

#[test]
fn what_only_online_training_reads_is_refused_without_it() {
    for setting in [
        "reward.agent_weight=0.5",
        "reward.experience=5000",
        "reward.experience_after_goal=true",
        "reward.order=improve-first",
        "reward.learning_rate_decay=true",
    ] {
        let words: &[&str] = &[OUT, "reward.samples = 0"];
        let [set, of_method] =
            ["reward.samples=0", "method=no-online"].map(|none| format!("{none} {setting}"));
        judge("navigation", &[(&set[..], words), (&of_method[..], words), (setting, &[])]);
    }
    judge("navigation", &[("method=soft-push-back reward.samples=0", &[])]);
}

#[test]
fn a_recorded_configuration_is_read_as_it_is() {
    let text = assemble("navigation", "").unwrap().to_text();
    let never_learned = text.replace("experience = 10000", "experience = 100");
    assert_ne!(never_learned, text);
    RunConfig::from_text(&never_learned, "an old run").unwrap();
}

/// Gives every key of ten methods extreme values. Each leads to a refusal or to an estimate of size, never to a panic.
#[test]
fn no_value_breaks_the_judgement() {
    const EDGES: [&str; 12] = [
        "0",
        "1",
        "-1",
        "9223372036854775807",
        "0.0",
        "1.0",
        "1e308",
        "5e-324",
        "nan",
        "inf",
        "[]",
        "[9223372036854775807, 9223372036854775807, 9223372036854775807]",
    ];
    let methods = [
        "goal-proximity",
        "temporal-distance",
        "proximity-discriminator",
        "segment-matching",
        "ranking",
        "gail",
        "bc",
        "bco",
        "sqil",
        "environment-reward",
    ];
    let mut taken = 0;
    for (task, method) in ["navigation", "ant-reach"]
        .into_iter()
        .flat_map(|task| methods.map(|method| (task, method)))
    {
        let method = format!("method={method}");
        let config = assemble(task, &method).unwrap();
        let keys = keys_of(&config.to_text());
        assert!(keys.len() > 50, "{keys:?}");
        for (key, edge) in keys.iter().flat_map(|key| EDGES.map(|edge| (key, edge))) {
            let settings = [method.clone(), format!("{key}={edge}")];
            if let Ok(config) = configuration(task, None, &settings) {
                let estimate = config.estimate(2);
                let numbers = [estimate.bytes(), estimate.environment_steps, estimate.row_passes];
                // Infinity is allowed: it is more than any machine has.
                let sound = numbers.iter().all(|number| *number >= 0.0);
                assert!(sound, "{task} {settings:?}: {estimate:?}");
                taken += 1;
            }
        }
    }
    assert!(taken > 500, "{taken}");
}

/// Returns the dotted keys of a configuration's text.
fn keys_of(text: &str) -> Vec<String> {
    let (mut table, mut keys) = (String::new(), Vec::new());
    for line in text.lines() {
        if let Some(name) = line.strip_prefix('[') {
            table = format!("{}.", name.trim_end_matches(']'));
        } else if let Some((key, _)) = line.split_once(" = ") {
            keys.push(format!("{table}{key}"));
        }
    }
    keys
}
