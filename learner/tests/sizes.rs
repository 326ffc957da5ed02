//! Compares the sizes that the configuration foresees with the networks of the policy learners.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

use protocol::tensors::Tensors;
use run::config::RunConfig;

fn config(task: &str, settings: &str) -> RunConfig {
    let settings: Vec<String> = settings.split_whitespace().map(str::to_owned).collect();
    run::tasks::configuration(task, None, &settings).unwrap()
}

fn assert_foreseen(config: &RunConfig) {
    let (learner, policy) = learner::algorithm::create(config, &[]);
    let mut tensors = Tensors::default();
    learner.save(&mut tensors);
    let of = |name: &str| tensors.f32(name).unwrap().len() as f64;
    let what = (&config.task.name, &config.method);
    assert_eq!(config.policy_size().parameters, policy.parameters.len() as f64, "{what:?} policy");
    if let Some(size) = config.inverse_dynamics_size() {
        assert_eq!(size.parameters, of("inverse.parameters"), "{what:?} inverse dynamics");
    }
    if let Some(size) = config.q_function_size() {
        assert_eq!(size.parameters, of("q0.parameters"), "{what:?} Q-function");
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
        ("navigation", "policy.convolution_channels=[3,5,17]"),
        ("navigation", "policy.convolution_channels=[3]"),
        ("navigation", "policy.convolution_kernel=3 policy.pool=1"),
        ("navigation", "method=bco inverse_dynamics.convolution_kernel=1 policy.pool=3"),
        ("navigation", "method=bco inverse_dynamics.convolution_channels=[2,3,4]"),
        ("fetch-pick", "policy.hidden=[3]"),
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
