"""What a network is told about its orders of pairs of pixels."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

DOUBT = 0.02
"""Share of stretches that may be wrong: beyond about 4 the loss of one no longer grows."""


def order_loss(
    logits: Tensor,
    classes: Tensor,
    bags: Tensor,
    bag_class: Tensor,
    bag_weight: Tensor,
    occlusion_weight: float,
    unknown_weight: float = 0.0,
    direction_weight: float = 0.0,
) -> Tensor:
    """Return the balanced cross entropy per known pair, summed over the pictures of a batch.

    `logits` (B, 2, 3, H, W); `classes` (B, 2, H, W) 0, 1, 2 or negative where unknown, where nothing counts; `bags`
    (n, K) flat indices into (B, 2, H, W), negative beyond the end. Exactly one pair of each bag has the class
    `bag_class` (n,): with p its probabilities, the likelihood of that is sum_i p_i prod_{j != i} (1 - p_j), which asks
    for one sharp answer and leaves its place to the picture. Occlusions weigh `occlusion_weight` times as much as
    pairs without. Unknown pairs count as pairs without, with `unknown_weight`: most pairs are none, and where nothing
    is ever labelled (the sky above the highest beam) a network is otherwise free to invent. Which of the two pixels
    hides the other is far harder to see than that there is an edge, and drowns in the many pairs without one: the
    cross entropy of the direction alone, given that there is an edge, is added with `direction_weight`.
    """
    log_p = F.log_softmax(logits.float(), dim=2)
    known = classes >= 0
    picked = log_p.gather(2, torch.where(known, classes, 1).long().unsqueeze(2)).squeeze(2)
    weight = torch.where(known, torch.where(classes == 1, 1.0, occlusion_weight), unknown_weight)
    # A crop that knows next to nothing must not count for more than one that is known all over.
    count = known.flatten(1).sum(1).clamp(min=0.01 * classes[0].numel())
    total = -((weight * picked).flatten(1).sum(1) / count).sum()
    either = torch.logaddexp(log_p[:, :, 0], log_p[:, :, 2])
    occluded = (known & (classes != 1)) * direction_weight
    total = total - ((occluded * (picked - either)).flatten(1).sum(1) / count).sum()
    if len(bags):
        likelihood = exactly_one(log_p, bags, bag_class)
        nll = -occlusion_weight * torch.log(DOUBT + (1 - DOUBT) * likelihood)
        nll = nll - direction_weight * torch.log(DOUBT + (1 - DOUBT) * right_direction(log_p, bags, bag_class))
        picture = bags[:, 0] // classes[0].numel()
        total = total + (bag_weight * nll / count[picture]).sum()
    return total


def exactly_one(log_p: Tensor, bags: Tensor, bag_class: Tensor) -> Tensor:
    """Return the likelihood (n,) that exactly one pair of each bag has its class, from log_p (B, 2, 3, H, W)."""
    pairs = log_p.movedim(2, -1).reshape(-1, 3)
    inside = bags >= 0
    log_yes = pairs[bags.clamp(min=0), bag_class.unsqueeze(1)].clamp(max=-1e-4)
    log_no = torch.log1p(-log_yes.exp())
    none = torch.where(inside, log_no, 0.0).sum(1)
    odds = torch.where(inside, log_yes - log_no, -torch.inf)
    return torch.exp(torch.logsumexp(odds, 1) + none)


def right_direction(log_p: Tensor, bags: Tensor, bag_class: Tensor) -> Tensor:
    """Return the share (n,) of the belief in an occlusion within each bag that has its class."""
    pairs = log_p.movedim(2, -1).reshape(-1, 3)
    inside = (bags >= 0).unsqueeze(2)
    belief = (pairs[bags.clamp(min=0)].exp() * inside).sum(1)
    return belief.gather(1, bag_class.unsqueeze(1)).squeeze(1) / (belief[:, 0] + belief[:, 2]).clamp(min=1e-6)
