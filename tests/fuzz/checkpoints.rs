//! Checkpoint files: weights, the learner's state, the service's state.

use std::cell::RefCell;

use learner::algorithm;
use learner::state::State;
use protocol::tensors::Tensors;
use protocol::trajectory::{Encoded, Source};
use protocol::weights::Weights;
use proximity_service::model::{GoalProximity, Learned, RewardModel};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::{Memory, Reader, fuzz, whole};

/// A file's header is JSON, which takes more memory than its length in the file.
const OF_FILES: Memory = Memory { bytes: 256 << 10, per_byte: 64 };

fn one_thread() -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(1).build().unwrap()
}

/// Returns the bytes of a file with these arrays.
fn file(tensors: &Tensors) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("some.safetensors");
    tensors.save(&path).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn weights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.safetensors");
    Weights::new(3, &[0.5; 9], &[0.25; 6]).save(&path).unwrap();
    let read = |bytes: &[u8]| {
        let weights = Weights::from_file(bytes)?;
        weights.sha256();
        Ok(())
    };
    fuzz(vec![std::fs::read(&path).unwrap()], &Reader { memory: OF_FILES, read: &read });
}

#[test]
fn state_of_the_learner() {
    let config = whole::config("fetch-push");
    let (learner, policy) = algorithm::create(&config, &[]);
    let state = State::fresh(policy, &config.rollout);
    let mut tensors = Tensors::default();
    state.save(&mut tensors);
    learner.save(&mut tensors);
    let trajectory = whole::trajectory("fetch-push", Source::Training);
    let batch = [Encoded::encode(trajectory)];
    let restored = RefCell::new((learner, state));
    let read = |bytes: &[u8]| {
        let (learner, state) = &mut *restored.borrow_mut();
        let tensors = Tensors::from_file(bytes)?;
        state.restore(&tensors)?;
        learner.restore(&tensors)?;
        // Use it as the next iteration does.
        state.plans(state.iteration, config.rollout.lane_steps);
        state.count(&batch);
        assert!((0.0..=1.0).contains(&state.success_rate()));
        state.policy.weights(state.iteration + 1).sha256();
        Ok(())
    };
    fuzz(vec![file(&tensors)], &Reader { memory: OF_FILES, read: &read });
}

#[test]
fn state_of_the_service() {
    let config = whole::config("fetch-push");
    let demonstrations = vec![whole::trajectory("fetch-push", Source::Demonstration); 2];
    let rate = config.reward_learning_rate();
    let spec = config.task.spec();
    let model = Learned::<GoalProximity>::new(
        &spec,
        &config.reward,
        rate,
        config.seed,
        &demonstrations,
        one_thread(),
    );
    let batch = [Encoded::encode(whole::trajectory("fetch-push", Source::Training))];
    let valid = file(&model.save());
    let model = RefCell::new(model);
    let read = |bytes: &[u8]| {
        let mut model = model.borrow_mut();
        model.restore(&Tensors::from_file(bytes)?)?;
        assert_eq!(model.score(3, &batch)[0].rewards.len(), 3);
        Ok(())
    };
    fuzz(vec![valid], &Reader { memory: OF_FILES, read: &read });
}
