"""The loss of pairs and of stretches of pairs: closed forms, symmetries, and gradients that stay finite."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from p2o_plugins.p2ornet.loss import DOUBT, exactly_one, order_loss
from torch import Tensor

NO_BAGS = (torch.zeros((0, 3), dtype=torch.int64), torch.zeros(0, dtype=torch.int64), torch.zeros(0))
H, W = 6, 9


def random_logits(seed: int, batch: int = 1, scale: float = 2.0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return scale * torch.randn(batch, 2, 3, H, W, generator=generator, dtype=torch.float64)


def random_labels(seed: int, batch: int = 1) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return classes with a few of each kind and unknown ones, and four bags a picture of one to four pairs."""
    rng = np.random.default_rng(seed)
    classes = rng.choice(np.array([-1, 0, 1, 1, 1, 2], np.int8), (batch, 2, H, W))
    classes[:, 0, :, -1] = -1
    classes[:, 1, -1] = -1
    bags = np.full((batch, 4, 4), -1)
    for picture, number in itertools.product(range(batch), range(4)):
        count = number + 1
        axis, v, u = number % 2, int(rng.integers(H - 1)), int(rng.integers(W - 4))
        pairs = ((picture * 2 + axis) * H + v) * W + u + np.arange(count)
        bags[picture, number, :count] = pairs
        classes.reshape(-1)[pairs] = -1
    chosen = rng.choice([0, 2], batch * 4)
    weight = rng.uniform(0.3, 1, batch * 4)
    return tuple(torch.from_numpy(x) for x in (classes, bags.reshape(-1, 4), chosen, weight))  # type: ignore[return-value]


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_exactly_one_is_what_counting_all_outcomes_gives(count: int) -> None:
    log_p = torch.log_softmax(random_logits(count), dim=2)
    for number in (0, 2):
        pairs = torch.tensor([[*range(3, 3 + count), -1, -1]])
        p = log_p[0, 0, number].reshape(-1)[3 : 3 + count].exp().numpy()
        expected = sum(
            np.prod(np.where(outcome, p, 1 - p))
            for outcome in itertools.product([False, True], repeat=count)
            if sum(outcome) == 1
        )
        assert float(exactly_one(log_p, pairs, torch.tensor([number]))) == pytest.approx(float(expected), rel=1e-9)


def test_one_sharp_answer_anywhere_is_best_and_thick_or_missing_ones_are_not() -> None:
    def likelihood(*certain: int) -> float:
        logits = torch.zeros(1, 2, 3, H, W)
        logits[:, :, 1] = 12.0
        for u in certain:
            logits[0, 0, 0, 2, u] = 24.0
        bags = torch.tensor([[2 * W + u for u in range(1, 6)]])
        return float(exactly_one(torch.log_softmax(logits, 2), bags, torch.tensor([0])))

    assert likelihood(2) > 0.99
    assert likelihood(2) == pytest.approx(likelihood(5), rel=1e-5)
    assert likelihood(7) < 0.01  # outside of the stretch
    assert likelihood() < 0.01
    assert likelihood(2, 3) < 0.01


def test_pairs_alone_cost_their_balanced_cross_entropy() -> None:
    classes = torch.full((1, 2, H, W), -1, dtype=torch.int8)
    classes[0, 0, 0, :6] = 1
    classes[0, 1, 2, :2] = torch.tensor([0, 2], dtype=torch.int8)
    loss = order_loss(torch.zeros(1, 2, 3, H, W), classes, *NO_BAGS, 4.0)
    assert float(loss) == pytest.approx(np.log(3) * (6 + 4 * 2) / 8)


def test_unknown_pairs_outside_of_all_stretches_teach_nothing_and_all_others_do() -> None:
    logits = random_logits(1).requires_grad_()
    classes, bags, chosen, weight = random_labels(1)
    order_loss(logits, classes, bags, chosen, weight, 4.0).backward()  # type: ignore[no-untyped-call]
    assert logits.grad is not None
    taught = logits.grad.abs().amax(dim=2) > 0
    known = classes >= 0
    known.reshape(-1)[bags[bags >= 0]] = True
    assert torch.equal(taught, known)


@pytest.mark.parametrize("size", [30.0, 1e4])
def test_gradients_are_finite_where_the_network_is_certain_right_or_wrong(size: float) -> None:
    for number in range(3):
        logits = torch.full((1, 2, 3, H, W), -size)
        logits[:, :, number] = size
        logits.requires_grad_()
        classes, bags, chosen, weight = random_labels(2)
        loss = order_loss(logits, classes, bags, chosen, weight.float(), 4.0)
        loss.backward()  # type: ignore[no-untyped-call]
        assert bool(torch.isfinite(loss))
        assert logits.grad is not None
        assert bool(torch.isfinite(logits.grad).all())


def test_one_wrong_stretch_costs_a_limited_amount() -> None:
    logits = torch.zeros(1, 2, 3, H, W)
    logits[:, :, 1] = 1000.0
    classes = torch.full((1, 2, H, W), -1, dtype=torch.int8)
    classes[0, 0, 0, :5] = 1
    bag = (torch.tensor([[20, 21, 22]]), torch.tensor([2]), torch.tensor([0.5]))
    assert float(order_loss(logits, classes, *bag, 4.0)) == pytest.approx(4.0 * 0.5 * -np.log(DOUBT) / 5, rel=1e-4)
