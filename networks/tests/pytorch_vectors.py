"""Generates pytorch_vectors.safetensors, which networks/tests/pytorch.rs compares the networks with.

    pip install torch numpy safetensors && python networks/tests/pytorch_vectors.py

Each case has one flat parameter tensor in the layout of the crate. PyTorch's layers read views of it,
so gradients and optimizer steps have that layout, too.
"""

import math
import pathlib

import torch
from safetensors.torch import save_file
from torch.nn import functional

ROWS, GRID, CLASSES, KERNEL, POOL = 8, 9, 4, 2, 2
CHANNELS, FEATURES, ACTIONS = [5, 18, 20], 17, 4
NUMBERS, HIDDEN, ACTION_NUMBERS = 7, [20, 18], 3


class Flat:
    """Hands out consecutive slices of a flat tensor."""

    def __init__(self, parameters):
        self.parameters, self.at = parameters, 0

    def take(self, *shape):
        count = math.prod(shape)
        self.at += count
        return self.parameters[self.at - count : self.at].view(*shape)

    def dense(self, x, outputs):
        weights = self.take(x.shape[1], outputs)
        return x @ weights + self.take(outputs)

    def convolution(self, x, channels):
        weights = self.take(KERNEL, KERNEL, x.shape[1], channels).permute(3, 2, 0, 1)
        return functional.conv2d(x, weights, self.take(channels))

    def encoder(self, cells):
        x = functional.one_hot(cells.long(), CLASSES).permute(0, 3, 1, 2).float()
        for index, channels in enumerate(CHANNELS):
            x = functional.relu(self.convolution(x, channels))
            x = functional.max_pool2d(x, POOL) if index == 0 else x
        return functional.relu(self.dense(x.permute(0, 2, 3, 1).flatten(1), FEATURES))

    def hidden(self, x):
        for outputs in HIDDEN:
            x = torch.tanh(self.dense(x, outputs))
        return x


def policy_loss(distribution, actions, values, advantages, returns):
    log_probabilities, entropies = distribution.log_prob(actions), distribution.entropy()
    if log_probabilities.dim() > 1:
        log_probabilities, entropies = log_probabilities.sum(1), entropies.sum(1)
    loss = -(log_probabilities * advantages).mean() - 0.01 * entropies.mean()
    loss = loss + 0.5 * ((values - returns) ** 2).mean()
    return loss, {"log_probabilities": log_probabilities, "entropies": entropies, "values": values}


def cells_policy(flat, data):
    outputs = flat.dense(flat.encoder(data["observations"]), ACTIONS + 1)
    distribution = torch.distributions.Categorical(logits=outputs[:, :ACTIONS])
    actions, values = data["actions"].long(), outputs[:, ACTIONS]
    return policy_loss(distribution, actions, values, data["advantages"], data["returns"])


def vector_policy(flat, data):
    means = flat.dense(flat.hidden(data["observations"]), ACTION_NUMBERS)
    values = flat.dense(flat.hidden(data["observations"]), 1)[:, 0]
    distribution = torch.distributions.Normal(means, flat.take(ACTION_NUMBERS).exp())
    return policy_loss(distribution, data["actions"], values, data["advantages"], data["returns"])


def cells_proximity(flat, data):
    outputs = flat.dense(flat.hidden(flat.encoder(data["observations"])), 1)[:, 0]
    return ((outputs - data["targets"]) ** 2).mean(), {"outputs": outputs}


def case(name, function, data):
    count = Flat(torch.zeros(1_000_000))
    function(count, data)
    parameters = (0.25 * torch.randn(count.at)).requires_grad_()
    optimizer = torch.optim.Adam([parameters], lr=1e-3, eps=1e-5)
    tensors = dict(data, parameters=parameters.detach().clone())
    for step in range(5):
        optimizer.zero_grad()
        loss, found = function(Flat(parameters), data)
        loss.backward()
        if step == 0:
            tensors.update(found, loss=loss.view(1), gradient=parameters.grad.clone())
        norm = torch.nn.utils.clip_grad_norm_([parameters], 0.5)
        if step == 0:
            tensors["norm"] = norm.view(1)
        optimizer.step()
    tensors["trained"] = parameters
    return {f"{name}.{key}": tensor.detach().clone() for key, tensor in tensors.items()}


def main():
    torch.manual_seed(1)
    cells = torch.randint(CLASSES, (ROWS, GRID, GRID), dtype=torch.uint8)
    shared = {"advantages": torch.randn(ROWS), "returns": torch.randn(ROWS)}
    discrete = torch.randint(ACTIONS, (ROWS,), dtype=torch.uint8)
    vectors = torch.randn(ROWS, NUMBERS)
    continuous = torch.randn(ROWS, ACTION_NUMBERS)
    cells_case = {"observations": cells, "actions": discrete, **shared}
    vector_case = {"observations": vectors, "actions": continuous, **shared}
    proximity_case = {"observations": cells, "targets": torch.rand(ROWS)}
    tensors = {
        **case("cells_policy", cells_policy, cells_case),
        **case("vector_policy", vector_policy, vector_case),
        **case("cells_proximity", cells_proximity, proximity_case),
    }
    save_file(tensors, pathlib.Path(__file__).with_suffix(".safetensors"))


if __name__ == "__main__":
    main()
