"""Loss of the predicted order of pairs of pixels."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

DOUBT = 0.02
"""Share of wrong spans: the loss of a span saturates at about 4."""


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
    """Return the balanced cross entropy per labelled pair, summed over the images of a batch.

    `logits` (B, 2, 3, H, W); `classes` (B, 2, H, W) 0, 1, 2 or negative for unlabelled pairs, which are ignored; `bags`
    (n, K) flat indices into (B, 2, H, W), negative beyond the end. Exactly one pair of each bag has the class
    `bag_class` (n,): with p its probabilities, the likelihood is sum_i p_i prod_{j != i} (1 - p_j), which favours one
    sharp response at a position that the image determines. Occlusions have `occlusion_weight` times the weight of pairs
    without. Unlabelled pairs are treated as pairs without occlusion, with `unknown_weight`: most pairs are none, and in
    regions without labels (the sky above the highest beam) the network is otherwise unconstrained. The direction of an
    occlusion is far harder to see than the edge and has little weight among the many pairs without one: the cross
    entropy of the direction alone, given an edge, is added with `direction_weight`.
    """
    log_p = F.log_softmax(logits.float(), dim=2)
    known = classes >= 0
    picked = log_p.gather(2, torch.where(known, classes, 1).long().unsqueeze(2)).squeeze(2)
    weight = torch.where(known, torch.where(classes == 1, 1.0, occlusion_weight), unknown_weight)
    # A crop with few labels must not have a larger weight than one with labels everywhere.
    count = known.flatten(1).sum(1).clamp(min=0.01 * classes[0].numel())
    total = -((weight * picked).flatten(1).sum(1) / count).sum()
    either = torch.logaddexp(log_p[:, :, 0], log_p[:, :, 2])
    occluded = (known & (classes != 1)) * direction_weight
    total = total - ((occluded * (picked - either)).flatten(1).sum(1) / count).sum()
    if len(bags):
        likelihood = exactly_one(log_p, bags, bag_class)
        nll = -occlusion_weight * torch.log(DOUBT + (1 - DOUBT) * likelihood)
        nll = nll - direction_weight * torch.log(DOUBT + (1 - DOUBT) * right_direction(log_p, bags, bag_class))
        image = bags[:, 0] // classes[0].numel()
        total = total + (bag_weight * nll / count[image]).sum()
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
