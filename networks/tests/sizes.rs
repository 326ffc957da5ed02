//! Compares the network sizes that the configuration predicts with the networks themselves.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use networks::{
    Activation, ActorCritic, Head, Initialization, Network, NetworkShape, PolicyArchitecture,
    RewardArchitecture,
};
use protocol::task::{ActionSpec, Task};
use run::config::{RewardInput, RunConfig};

fn config(task: &str, settings: &str) -> RunConfig {
    let settings: Vec<String> = settings.split_whitespace().map(str::to_owned).collect();
    run::tasks::configuration(task, None, &settings).unwrap()
}

fn action_numbers(task: &Task) -> usize {
    match task.spec().action {
        ActionSpec::Discrete { count } => count,
        ActionSpec::Continuous { len } => len,
    }
}

/// Creates a member of the ensemble, as the proximity service does.
fn member(config: &RunConfig) -> Network {
    let (frames, extra_inputs) = match config.reward.input {
        RewardInput::State | RewardInput::NextState => (1, 0),
        RewardInput::Transition => (2, 0),
        RewardInput::StateAction => (1, action_numbers(&config.task)),
    };
    let reward = &config.reward;
    let architecture = RewardArchitecture {
        cells: reward.encoder(),
        hidden: reward.hidden.clone(),
        ..RewardArchitecture::default()
    };
    Network::new(architecture.network_shape(config.task.spec().observation, frames, extra_inputs))
}

fn assert_foreseen(config: &RunConfig) {
    let spec = config.task.spec();
    let policy =
        ActorCritic::new(spec.observation, spec.action, &PolicyArchitecture::from(&config.policy));
    let what = (&config.task.name, &config.method);
    assert_eq!(config.policy_size().parameters, policy.parameter_count() as f64, "{what:?} policy");
    let member = member(config).parameter_count();
    assert_eq!(config.member_size().parameters, member as f64, "{what:?} member");
    if let (Some(size), Some(own)) = (config.inverse_dynamics_size(), &config.inverse_dynamics) {
        let architecture = PolicyArchitecture {
            cells: own.encoder(),
            hidden: own.hidden.clone(),
            frames: 2,
            ..PolicyArchitecture::default()
        };
        let inverse = ActorCritic::new(spec.observation, spec.action, &architecture);
        assert_eq!(size.parameters, inverse.parameter_count() as f64, "{what:?} inverse dynamics");
    }
    if let (Some(size), Some(own)) = (config.q_function_size(), &config.sqil) {
        let q_function = Network::new(NetworkShape {
            observation: spec.observation,
            frames: 1,
            extra_inputs: action_numbers(&config.task),
            cells: config.policy.encoder(),
            hidden: own.hidden.clone(),
            activation: Activation::Relu,
            hidden_initialization: Initialization::FanIn,
            heads: vec![Head { outputs: 1, initialization: Initialization::FanIn }],
        });
        assert_eq!(size.parameters, q_function.parameter_count() as f64, "{what:?} Q-function");
    }
}

#[test]
fn parameters_are_foreseen() {
    let methods = ["goal-proximity", "gaifo", "gail", "bc", "bco", "sqil", "environment-reward"];
    for (task, method) in ["navigation", "fetch-pick", "fetch-push", "ant-reach"]
        .into_iter()
        .flat_map(|task| methods.map(|name| (task, name)))
    {
        assert_foreseen(&config(task, &format!("method={method}")));
    }
    for (task, settings) in [
        ("navigation", "policy.shared_trunk=false policy.features=7"),
        ("navigation", "policy.convolution_channels=[3,5,17] reward.hidden=[]"),
        ("navigation", "policy.convolution_channels=[3] reward.convolution_channels=[2,3,4,5]"),
        ("navigation", "policy.convolution_kernel=3 policy.pool=1 reward.pool=4"),
        ("navigation", "method=bco inverse_dynamics.convolution_kernel=1 policy.pool=3"),
        ("navigation", "method=gail reward.hidden=[9,33] reward.features=5"),
        ("navigation", "method=bco inverse_dynamics.convolution_channels=[2,3,4]"),
        ("fetch-pick", "policy.hidden=[3] reward.hidden=[1,2,3]"),
        ("fetch-push", "policy.hidden=[] policy.distribution=squashed-gaussian"),
        ("ant-reach", "method=sqil sqil.hidden=[3,4,5]"),
        ("ant-reach", "method=bco inverse_dynamics.hidden=[300]"),
    ] {
        assert_foreseen(&config(task, settings));
    }
    assert!(config("fetch-push", "method=sqil").q_function_size().is_some());
    assert!(config("navigation", "method=bco").inverse_dynamics_size().is_some());
}

#[test]
fn q_functions_over_a_grid_have_the_encoder_of_the_policy() {
    let task = "[task]\nname = \"sliding\"\naction.continuous.len = 2\nhorizon_steps = 20\n\
                observation.cells = { height = 5, width = 5, classes = 3 }\n\
                [reward]\nconvolution_channels = [6]\npool = 1\n";
    let settings = ["method=sqil", "policy.convolution_channels=[6]", "policy.pool=1"];
    let config = run::tasks::of_text(task, "sliding", None, &settings.map(str::to_owned)).unwrap();
    assert!(config.q_function_size().is_some());
    assert_foreseen(&config);
}
