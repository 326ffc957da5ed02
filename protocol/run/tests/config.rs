//! The configuration: presets and settings over a task's file, and the words of refusals.

use std::path::PathBuf;

use protocol::Error;
use protocol::description::Description;
use protocol::trajectory::{Encoded, Trajectory};
use run::config::{RewardForm, RewardModelKind, RunConfig, UpdateOrder};
use run::tasks::{configuration, of_text};

fn assemble(preset: &str, settings: &[&str]) -> Result<RunConfig, Error> {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    configuration("navigation", Some(preset), &settings)
}

fn refusal(preset: &str, settings: &[&str]) -> String {
    assemble(preset, settings).expect_err("to be refused").to_string()
}

#[test]
fn a_preset_changes_the_file_and_a_setting_changes_the_preset() {
    let paper = assemble("paper", &[]).unwrap();
    assert_eq!((paper.preset.as_str(), paper.reward.delta), ("paper", 0.01));
    assert_eq!(paper.reward.order, UpdateOrder::ScoreFirst);
    let authors = assemble("authors", &["seed=7", "reward.delta=0.9"]).unwrap();
    assert_eq!((authors.seed, authors.reward.delta), (7, 0.9));
    assert_eq!(authors.reward.order, UpdateOrder::ImproveFirst);
    let other = assemble("goalward", &["method=environment-reward"]).unwrap();
    assert_eq!(other.reward.model, RewardModelKind::named("environment").unwrap());
    assert!(!other.imitates() && !other.needs_expert_actions());
}

#[test]
fn a_method_changes_the_preset_and_a_setting_changes_the_method() {
    let cloning = |settings: &[&str]| {
        let settings = [&["method=bc"], settings].concat();
        assemble("paper", &settings).unwrap().cloning.unwrap()
    };
    assert_eq!((cloning(&[]).epochs, cloning(&[]).batch), (1000, 64), "a task's own change");
    assert_eq!(cloning(&["cloning.batch=32"]).batch, 32);
    let bc = assemble("goalward", &["method=bc"]).unwrap();
    assert_eq!((bc.iterations(), bc.steps_wanted()), (1000, 0));
    assert!(bc.imitates() && bc.needs_expert_actions());
    assert!(!assemble("goalward", &["method=bco"]).unwrap().needs_expert_actions());
    let message = refusal("goalward", &["method=sqil", "log.observations=false"]);
    assert!(message.contains("`log.observations` must be true for sqil"), "{message}");
    let gail = assemble("goalward", &["method=gail"]).unwrap();
    assert!(gail.needs_expert_actions() && gail.iterations() > 300);
}

#[test]
fn a_method_begins_with_the_changes_of_the_one_it_is_like() {
    let [gaifo_s, gail] =
        ["method=gaifo-s", "method=gail"].map(|method| assemble("goalward", &[method]).unwrap());
    let differences = gaifo_s.result_differences(&gail);
    let keys: Vec<&str> = differences.iter().map(|(key, _)| key.as_str()).collect();
    assert_eq!(keys, ["method", "reward.input"]);
}

#[test]
fn the_effective_configuration_reads_back_the_same() {
    for preset in ["goalward", "paper", "authors"] {
        let config = assemble(preset, &["demonstrations.file=some/where.mcap"]).unwrap();
        assert_eq!(RunConfig::from_text(&config.to_text(), "test").unwrap(), config);
    }
}

#[test]
fn what_is_wrong_is_named() {
    for (setting, words) in [
        ("ppo.clipp=0.3", "clipp"),
        ("ppo.clip", "key=value"),
        ("ppo.clip=0", "`ppo.clip` must be above 0, found 0"),
        ("ppo.gamma=1.5", "`ppo.gamma` must be above 0 and at most 1, found 1.5"),
        ("task.horizon_steps=50", "task.horizon_steps is set in the task's file"),
        ("resources.actors=65", "at most 64"),
        ("resources.lease_timeout_ms=9223372036854775807", "at most a day"),
        ("log.file_mib=9223372036854775807", "at most 1048576"),
        ("rollout.lag=2", "0 or 1"),
        ("rollout.lane_steps=64", "at least the longest episode, 100, found 64"),
        ("reward.samples=8", "0 or at least reward.batch = 32, found 8"),
        ("reward.ensemble=1", "at least 2 with reward.uncertainty = 0.01, found 1"),
        ("steps=-1", "-1"),
        ("steps=1e5", "in `steps`: expected a whole number that is not negative, found floating"),
        ("ppo=3", "--set: in `ppo`: expected a table, found integer `3`"),
        ("reward.order=3", "expected score-first or improve-first, found 3"),
        ("task=chess", "would only change the name"),
        ("method=magic", "`method` must be one of absolute, "),
        ("learner=bc", "`reward.model` must be none for bc, which asks for no rewards"),
        ("reward.model=none", "`reward.model` must be some for ppo"),
        ("reward.form=gail", "`reward.form`"),
        ("reward.input=transition", "`reward.input` must be state or state-action with proximity"),
        ("reward.gradient_penalty=1.0", "0, except for a discriminator of vector observations"),
        ("reward.weight_decay=-1.0", "`reward.weight_decay` must be between 0e0 and 1e6"),
        ("reward.prior=-1.0", "`reward.prior` must be between 0e0 and 1e6"),
    ] {
        let message = refusal("goalward", &[setting]);
        assert!(message.contains(words), "{setting}: expected {words} in: {message}");
        assert!(!message.contains('\n'), "{setting}: one line, found: {message}");
    }
    for (method, setting, words) in [
        ("ranking", "reward.bootstrap=true", "`reward.bootstrap` must be false with ranking"),
        ("bco", "inverse_dynamics.samples=8", "at least inverse_dynamics.batch = 128, found 8"),
        ("bco", "inverse_dynamics.experience=8", "at least inverse_dynamics.samples = 8192"),
        ("sqil", "sqil.experience=8", "at least sqil.batch = 32, found 8"),
        (
            "sqil",
            "sqil.expert_after_goal=false",
            "in `sqil.expert_after_goal`: expected one of continues, terminal, absorbing, found false",
        ),
    ] {
        let method = format!("method={method}");
        let message = refusal("goalward", &[method.as_str(), setting]);
        assert!(message.contains(words), "{method} {setting}: expected {words} in: {message}");
    }
    assert!(refusal("best", &[]).contains("one of goalward, authors, paper"));
}

#[test]
fn what_a_file_has_wrong_is_told_with_the_file_and_the_table() {
    let own = "[task]\nname = \"own\"\nobservation.vector.len = 2\naction.discrete.count = 2\n\
               horizon_steps = 10\n";
    let refusal = |text: &str, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
        of_text(&format!("{own}{text}"), "own.toml", None, &settings).unwrap_err().to_string()
    };
    for (text, settings, words) in [
        ("[ppo]\nclipp = 0.3\n", &[][..], "own.toml: in `ppo`: unknown field `clipp`"),
        ("[ppo]\nclip = \"wide\"\n", &["seed=2"], "own.toml: in `ppo.clip`"),
        ("", &["ppo.clip=wide"], "--set: in `ppo.clip`"),
        ("[environment]\nwind = [0.5, nan]\n", &[], "`environment.wind` must be finite"),
        ("", &["environment.wind=[0.5, inf]"], "expected a finite environment.wind"),
        ("", &["environment.wind=[{ x = nan }]"], "expected a finite environment.wind"),
        ("", &["ppo.clipp=0.3"], "--set ppo.clipp: expected an existing key, such as ppo.clip"),
    ] {
        let said = refusal(text, settings);
        assert!(said.contains(words), "expected {words} in: {said}");
    }
    let settings = ["seed=1".to_owned()];
    let said = of_text(own, "own.toml", Some("paper"), &settings).unwrap_err().to_string();
    assert!(said.contains("`preset` must be one of goalward, found paper"), "{said}");
}

#[test]
fn a_message_of_the_log_holds_the_longest_episode() {
    let pixels = "[task]\nname = \"pixels\"\nobservation.vector.len = 27648\n\
                  action.discrete.count = 4\nhorizon_steps = 1000\n[rollout]\nlane_steps = 1250\n";
    let judged = |text: &str, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
        of_text(text, "pixels", None, &settings)
    };
    let refusal = |text: &str, settings: &[&str]| judged(text, settings).unwrap_err().to_string();
    let why = "an episode of 1000 steps has 110712616 bytes, a message of the log at most 33554432";
    let said = refusal(pixels, &[]);
    assert!(
        said.contains(&format!("`log.observations` must be false: {why}, found true")),
        "{said}"
    );
    let without = judged(pixels, &["log.observations=false"]).unwrap();
    judged(&pixels.replace("1000", "300"), &[]).unwrap();
    // A recorded configuration is read as it is.
    let text = without.to_text().replace("\nobservations = false", "\nobservations = true");
    assert!(RunConfig::from_text(&text, "an old run").unwrap().log.observations);
    // Observations cannot be left out, or actions alone are too long.
    let changing = pixels.replace("[rollout]", "deterministic = false\n[rollout]");
    for said in [refusal(pixels, &["method=sqil"]), refusal(&changing, &[])] {
        assert!(said.contains(&format!("`task.horizon_steps` must be smaller: {why}")), "{said}");
    }
    let endless = pixels.replace("1000", "1000000").replace("1250", "1250000");
    let endless = endless.replace("discrete.count = 4", "continuous.len = 9");
    let said = refusal(&endless, &["log.observations=false"]);
    assert!(said.contains("`task.horizon_steps` must be smaller"), "{said}");
}

#[test]
fn an_encoded_episode_has_as_many_bytes_as_foreseen() {
    let spec = assemble("goalward", &[]).unwrap().task.spec();
    let steps = spec.horizon_steps;
    let of_steps = |bytes: usize| vec![1_u8; steps as usize * bytes];
    let longest = Trajectory {
        task: "navigation".to_owned(),
        steps,
        observation_shape: spec.observation.shape(),
        cells: vec![1_u8; (steps as usize + 1) * spec.observation.bytes()].into(),
        discrete_actions: of_steps(spec.action.bytes()).into(),
        log_probs: of_steps(4).into(),
        environment_rewards: of_steps(4).into(),
        ..Trajectory::default()
    };
    let without = longest.clone().actions_only(7);
    for (trajectory, observations) in [(longest, true), (without, false)] {
        let found = Encoded::encode(trajectory).bytes.len() as u64;
        let most = Trajectory::most_bytes(&spec, observations);
        assert!((most - 1024..=most).contains(&found), "{found} of {most}");
    }
}

#[test]
fn only_what_changes_weights_makes_another_result() {
    let base = assemble("goalward", &[]).unwrap();
    let same = |setting: &str| base.same_result_as(&assemble("goalward", &[setting]).unwrap());
    for setting in ["resources.actors=7", "checkpoint.keep=9", "log.file_mib=10"] {
        assert!(same(setting), "{setting}");
    }
    for setting in ["seed=2", "steps=9000", "rollout.lag=1", "ppo.clip=0.1"] {
        assert!(!same(setting), "{setting}");
    }
}

#[test]
fn learning_rates_fall_over_their_own_steps_or_over_the_run() {
    let rates = |settings: &[&str]| {
        let config = assemble("goalward", settings).unwrap();
        [config.policy_learning_rate(), config.reward_learning_rate()]
    };
    let at_first = ["ppo.learning_rate=0.5", "reward.learning_rate=0.25", "steps=8192"];
    let [policy, reward] = rates(&at_first);
    assert_eq!([0, 1, 2, 3].map(|iteration| policy.at(iteration)), [0.5, 0.25, 0.0, 0.0]);
    assert_eq!((reward.at(0), reward.at(99)), (0.25, 0.25), "stays by default");
    let decays = ["reward.learning_rate_decay=true", "reward.decay_steps=16384"];
    let [_, reward] = rates(&[&at_first[..], &decays].concat());
    assert_eq!([0, 1, 4, 5].map(|iteration| reward.at(iteration)), [0.25, 0.1875, 0.0, 0.0]);
}

#[test]
fn episodes_are_spread_over_lanes() {
    let rollout = assemble("goalward", &["rollout.lanes=4"]).unwrap().rollout;
    assert_eq!(rollout.spread(10), [3, 3, 2, 2]);
    assert_eq!(rollout.spread(2), [1, 1]);
}

#[test]
fn demonstrations_come_from_a_file_where_the_task_has_no_expert() {
    let described = |settings: &[&str], has_expert| {
        let mut config = assemble("goalward", settings).unwrap();
        if settings.is_empty() {
            config.demonstrations.file = Some(PathBuf::from("shown.mcap"));
        }
        let (environment, demonstrations) =
            (config.environment.clone(), config.demonstration_setting());
        let task = config.task.clone();
        config.described(Description { task, environment, demonstrations, has_expert })
    };
    let message = described(&["seed=1"], false).unwrap_err().to_string();
    assert!(
        message.contains("`demonstrations.file`") && message.contains("no expert"),
        "{message}"
    );
    for (settings, has_expert) in
        [(&["seed=1"][..], true), (&["method=environment-reward"], false), (&[], false)]
    {
        assert!(described(settings, has_expert).is_ok(), "{settings:?}");
    }
}

#[test]
fn arrival_is_estimated_only_from_single_states_and_where_nobody_tells_of_it() {
    let hidden = ["reward.experience_after_goal=true", "reward.arrival=0.8"];
    assert_eq!(assemble("goalward", &hidden).unwrap().reward.arrival, 0.8);
    let refused = |settings: &[&str], words: &str| {
        let said = refusal("goalward", settings);
        assert!(said.contains("`reward.arrival`") && said.contains(words), "{said}");
    };
    refused(&hidden[1..], "the environment tells when the agent arrives");
    refused(&[hidden[0], hidden[1], "method=gaifo"], "not one of single states");
    for discriminator in ["method=gaifo-s", "method=proximity-discriminator"] {
        refused(&[hidden[0], hidden[1], discriminator], "0 with a discriminator");
    }
    refused(&[hidden[0], "reward.arrival=1.5"], "between 0e0 and 1e0");
}

/// Assembles the configuration of a task whose file has `more` lines and that does not tell success.
fn untold(more: &str, settings: &[&str]) -> Result<RunConfig, Error> {
    let own = "[task]\nname = \"robot\"\nobservation.vector.len = 2\naction.discrete.count = 2\n\
               horizon_steps = 80\ntells_success = false\n";
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    of_text(&format!("{own}{more}"), "robot", None, &settings)
}

#[test]
fn an_arrival_that_a_tasks_file_estimates_is_refused_for_models_that_cannot() {
    let assembled = |settings: &[&str]| untold("[reward]\narrival = 0.8\n", settings);
    assembled(&[]).unwrap();
    for method in ["method=gaifo-s", "method=gaifo", "method=gail"] {
        let said = assembled(&[method]).unwrap_err().to_string();
        assert!(said.contains("`reward.arrival` must be 0 with a discriminator"), "{said}");
        assembled(&[method, "reward.arrival=0"]).unwrap();
    }
    let said = assembled(&["reward.input=state-action"]).unwrap_err().to_string();
    assert!(said.contains("`reward.arrival` must be 0 unless"), "{said}");
}

#[test]
fn what_follows_the_goal_of_the_agent_is_refused_where_nobody_tells_of_it() {
    let with = |setting| untold("", &["method=sqil", setting]);
    with("sqil.expert_after_goal=terminal").unwrap();
    let said = with("sqil.agent_after_goal=terminal").unwrap_err().to_string();
    assert!(said.contains("`sqil.agent_after_goal` must be left out"), "{said}");
}

#[test]
fn a_trained_model_takes_only_what_scoring_reads() {
    let scoring = |method: &str, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
        assemble("goalward", &[method]).unwrap().for_scoring(&settings)
    };
    let other = [
        "reward.form=absolute",
        "reward.final_bonus=true",
        "reward.uncertainty=0",
        "reward.offset=-1.5",
        "reward.prior=0",
    ];
    let found = scoring("method=goal-proximity", &other).unwrap().reward;
    assert_eq!(
        (found.form, found.final_bonus, found.uncertainty, found.offset),
        (RewardForm::Absolute, true, 0.0, -1.5)
    );
    for (method, setting, words) in [
        (
            "goal-proximity",
            "reward.delta=0.9",
            "`reward.delta` must be 0.95, with which the model is",
        ),
        ("goal-proximity", "reward.discounting=linear", "trained already"),
        ("goal-proximity", "reward.agent_weight=0.5", "trained already"),
        ("goal-proximity", "reward.pretraining_epochs=3", "trained already"),
        ("goal-proximity", "reward.prior=1.0", "trained already"),
        ("goal-proximity", "reward.model=ranking", "`reward.model` must be proximity or one that"),
        ("goal-proximity", "reward.model=nearest", "unknown model"),
        ("goal-proximity", "reward.form=gail", "`reward.form`"),
        ("environment-reward", "reward.model=proximity", "no other is trained already"),
        ("gaifo-s", "reward.final_bonus=true", "left out"),
        ("segment-matching", "reward.delta=0.9", "left out"),
    ] {
        let said = scoring(&format!("method={method}"), &[setting]).unwrap_err().to_string();
        assert!(said.contains(words), "{method} {setting}: expected {words} in: {said}");
    }
    // What learns nothing may change, also in runs that could not learn from it.
    for (method, settings) in [
        ("segment-matching", &["reward.segments=5"][..]),
        ("goal-proximity", &["reward.model=nearest-state", "reward.segments=5"]),
        ("goal-proximity", &["reward.model=environment"]),
        ("bco", &["reward.model=nearest-state"]),
        ("sqil", &["reward.model=environment"]),
    ] {
        scoring(&format!("method={method}"), settings).unwrap();
    }
}
