"""Makes ppo_vectors.safetensors, which tests/ppo_pytorch.rs compares with PPO's update.

    pip install torch numpy safetensors && python learner/tests/ppo_vectors.py

Each case has a batch of episodes, some of them cut off by the horizon; a small actor and critic, whose
parameters are one flat tensor in the layout of the crate `networks`; and the results of PPO passes over
the whole batch, in the later of which ratios and values leave their clip ranges. PyTorch computes in
double precision.
"""

import math
import pathlib

import torch
from safetensors.torch import save_file

NUMBERS, HIDDEN, PASSES = 5, 6, 8
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE = 0.99, 0.95, 0.2, 0.02, 0.5
LEARNING_RATE, EPSILON, LARGEST_NORM = 0.02, 1e-3, 0.5
STEPS = [1, 6, 3, 4, 2, 5, 7, 1, 4, 3]
CUT = [1, 0, 1, 0, 1, 0, 1, 0, 1, 0]


class Categorical:
    outputs, deviations = 3, 0

    def draw(self, parameters):
        return torch.distributions.Categorical(logits=parameters).sample().to(torch.uint8)

    def judge(self, parameters, actions):
        distribution = torch.distributions.Categorical(logits=parameters)
        return distribution.log_prob(actions.long()), distribution.entropy()


class Gaussian:
    outputs, deviations = 2, 2

    def normal(self, parameters):
        means, logs = parameters.chunk(2, 1)
        return torch.distributions.Normal(means, logs.exp())

    def draw(self, parameters):
        return self.normal(parameters).sample().float()

    def judge(self, parameters, actions):
        normal = self.normal(parameters)
        return normal.log_prob(actions.double()).sum(1), normal.entropy().sum(1)


class Squashed(Gaussian):
    outputs, deviations = 4, 0

    def draw(self, parameters):
        return super().draw(parameters).tanh().clamp(-0.99, 0.99)

    def judge(self, parameters, actions):
        actions = actions.double()
        log_probabilities, entropies = super().judge(parameters, actions.atanh())
        return log_probabilities - (1 - actions**2 + 1e-6).log().sum(1), entropies


class Model:
    """Actor, critic and log standard deviations, as consecutive parts of one flat tensor."""

    def __init__(self, kind):
        self.kind = kind
        network = lambda outputs: [(NUMBERS, HIDDEN), (HIDDEN,), (HIDDEN, outputs), (outputs,)]
        self.shapes = [*network(kind.outputs), *network(1), (kind.deviations,)]
        self.count = sum(math.prod(shape) for shape in self.shapes)

    def __call__(self, flat, observations):
        parts = flat.split([math.prod(shape) for shape in self.shapes])
        parts = [part.view(shape) for part, shape in zip(parts, self.shapes)]
        actor, critic = [torch.tanh(observations @ w + b) @ v + c for w, b, v, c in (parts[:4], parts[4:8])]
        logs = parts[8].expand(len(observations), -1)
        return torch.cat([actor, logs], 1), critic[:, 0]


def advantages(rewards, values, last_values):
    """Computes generalized advantages by their definition, episode by episode."""
    result, start = [], 0
    for steps, last in zip(STEPS, last_values):
        own = torch.cat([values[start : start + steps], last.view(1)])
        errors = rewards[start : start + steps] + GAMMA * own[1:] - own[:-1]
        for step in range(steps):
            decay = (GAMMA * LAMBDA) ** torch.arange(steps - step)
            result.append((decay * errors[step:]).sum())
        start += steps
    return torch.stack(result)


def case(name, kind, bootstrap, value_clip):
    model, rows = Model(kind), sum(STEPS)
    parameters = (0.4 * torch.randn(model.count)).float()
    observations = torch.randn(rows, NUMBERS).float()
    last_observations = torch.randn(len(STEPS), NUMBERS).float()
    rewards = torch.rand(rows).float()
    with torch.no_grad():
        acted = parameters + 0.05 * torch.randn(model.count)
        of_actor = model(acted, observations.double())[0]
        actions = kind.draw(of_actor)
        log_probs = kind.judge(of_actor, actions)[0].float()
        old_values = model(parameters.double(), observations.double())[1]
        last_values = model(parameters.double(), last_observations.double())[1]
        last_values = last_values * torch.tensor(CUT) * bootstrap
        advantage = advantages(rewards.double(), old_values, last_values)
        returns = advantage + old_values
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-5)
    flat = parameters.double().requires_grad_()
    optimizer = torch.optim.Adam([flat], lr=LEARNING_RATE, eps=EPSILON)
    figures, clipped_values = [], 0
    for _ in range(PASSES):
        of_actor, values = model(flat, observations.double())
        log_probabilities, entropies = kind.judge(of_actor, actions)
        difference = log_probabilities - log_probs.double()
        ratio = difference.exp()
        surrogate = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage)
        errors = (values - returns) ** 2
        if value_clip:
            held = old_values + (values - old_values).clamp(-value_clip, value_clip)
            errors = torch.max(errors, (held - returns) ** 2)
            clipped_values += int((held != values).sum())
        policy_loss, value_loss, entropy = -surrogate.mean(), 0.5 * errors.mean(), entropies.mean()
        optimizer.zero_grad()
        (policy_loss + VALUE * value_loss - ENTROPY * entropy).backward()
        norm = torch.nn.utils.clip_grad_norm_([flat], LARGEST_NORM)
        divergence = ((ratio - 1) - difference).mean()
        clipped = ((ratio - 1).abs() > CLIP).double().mean()
        figures.append(torch.stack([policy_loss, value_loss, entropy, divergence, clipped, norm]))
        optimizer.step()
    figures = torch.stack(figures).detach().mean(0)
    print(f"{name}: {figures[4]:.0%} of ratios clipped, {clipped_values} of {PASSES * rows} values")
    tensors = {
        "parameters": parameters, "observations": observations, "last_observations": last_observations,
        "actions": actions, "log_probs": log_probs, "rewards": rewards, "figures": figures,
        "steps": torch.tensor(STEPS, dtype=torch.uint8), "cut": torch.tensor(CUT, dtype=torch.uint8),
        "value_clip": torch.tensor([value_clip]), "bootstrap": torch.tensor([bootstrap], dtype=torch.uint8),
        "trained": flat,
    }  # fmt: skip
    narrow = lambda tensor: tensor.detach().float() if tensor.is_floating_point() else tensor
    return {f"{name}.{key}": narrow(tensor).contiguous() for key, tensor in tensors.items()}


def main():
    torch.manual_seed(1)
    torch.set_default_dtype(torch.float64)
    tensors = {}
    for kind in (Categorical(), Gaussian(), Squashed()):
        name = type(kind).__name__.lower()
        tensors |= case(f"{name}_clipped", kind, 1, 0.2)
        tensors |= case(f"{name}_unclipped", kind, 0, 0.0)
    save_file(tensors, pathlib.Path(__file__).with_suffix(".safetensors"))


if __name__ == "__main__":
    main()
