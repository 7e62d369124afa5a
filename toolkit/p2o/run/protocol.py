"""Protocols of publications by name: how initial guesses are drawn, on which frames, and the figures reported.

Read in their code where that is public; docs/protocols.md names each source and how ours differs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from p2o.arrays import Float
from p2o.errors import UnknownNameError
from p2o.geometry.pose_error import pose_metrics


@dataclass(frozen=True)
class Protocol:
    """Define how initial guesses are drawn and errors are reported, under a name of `--protocol`.

    `perturb` is the draw as `--perturb` takes it; `metrics` are the figures of `pose_metrics` that the publication
    reports, `limits` its success or hit rates by name (degrees, metres), `frames` what it is run on, `source` where it
    comes from.
    """

    name: str
    perturb: str
    metrics: tuple[str, ...]
    source: str
    frames: str
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def figures(self, estimates: Float, truths: Float) -> dict[str, float]:
        """Compute the reported figures, by name, from estimates (N, 4, 4) and ground truth (N, 4, 4)."""
        metrics = pose_metrics(estimates, truths, self.limits)
        return {name: metrics[name] for name in (*self.metrics, *self.limits) if name in metrics}


_SINGLE = ("rotation_deg_mean", "rotation_deg_median", "translation_m_mean", "translation_m_median")
_AXES = ("euler_deg_x", "euler_deg_y", "euler_deg_z", "shift_m_x", "shift_m_y", "shift_m_z")
_PER_AXIS = ("euler_deg_mean", "shift_m_mean", *_AXES)
_00 = "KITTI odometry 00, left colour camera, 4541 frames"
_BORER, _BORER_FRAMES = "Borer et al., arXiv 2311.01905", "KITTI raw 2011_09_30 drive 0018, 25 frames"
_SHIFTS = ("shift_m_norm", "shift_m_mean")
_L1_L2 = {"l1": (1.0, 0.025), "l2": (2.0, 0.05)}


def _lccnet(angle: int, length: float) -> Protocol:
    metrics = (*_SINGLE, "rotation_deg_std", "translation_m_std", *_AXES)
    return Protocol(f"lccnet-{angle}", f"euler camera {angle}deg {length}m", metrics, "LCCNet, CVPRW 2021", _00)


def _projfusion(angle: int, centimetres: int) -> Protocol:
    perturb, metrics = f"cube camera {angle}deg {centimetres}cm", ("euler_deg_norm", "euler_deg_mean", *_SHIFTS)
    source, frames = "NativeCross / ProjFusion, RA-L 2026", "KITTI odometry 13, 14, 15, 16, 18"
    return Protocol(f"projfusion-{angle}-{centimetres}", perturb, metrics, source, frames, _L1_L2)


def _borer(angle: int) -> Protocol:
    metrics, limits = ("rotation_deg_mean", "rotation_deg_median"), {"hit_rate": (0.5, float("inf"))}
    frames = f"{_BORER_FRAMES}; 200 seeds, one a direction"
    return Protocol(f"borer-{angle}", f"fibonacci {angle}deg", metrics, _BORER, frames, limits)


PROTOCOLS: Mapping[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        Protocol("p2o-calib", "2deg 0.15m", _SINGLE, "P2O-Calib, IROS 2023", "KITTI raw 2011_09_26"),
        *(_lccnet(angle, length) for angle, length in ((20, 1.5), (10, 1.0), (5, 0.5), (2, 0.2), (1, 0.1))),
        Protocol(
            "cmrnext",
            "euler 20deg 1.5m z=-1.5..1m",
            (
                *("rotation_deg_median", "translation_m_median", "rotation_deg_mean", "translation_m_mean"),
                *("median_rotation_deg", "median_translation_m", "mode_rotation_deg", "mode_translation_m"),
            ),
            "CMRNext, T-RO 2025",
            _00,
        ),
        Protocol("bevcalib", "norm 20deg 1.5m", (*_SINGLE, *_PER_AXIS), "BEVCalib, CoRL 2025", "KITTI odometry"),
        Protocol(
            "calibdepth",
            "euler camera 10deg 0.25m",
            (*_PER_AXIS, "rotation_deg_mean", "translation_m_mean"),
            "CalibNet, IROS 2018; CalibDepth, ICRA 2023",
            "KITTI raw 2011_09_26, frame lists of CalibDepth",
        ),
        *(_projfusion(angle, cm) for angle, cm in ((15, 15), (10, 25), (10, 50), (5, 50))),
        Protocol("calibvit-10-25", "euler camera 10deg 0.25m", _PER_AXIS, "CalibViT", _00),
        Protocol("claim", "10deg 0.2m", _SINGLE, "CLAIM, IROS 2025", "KITTI odometry 00, 50 frames evenly apart"),
        *(_borer(angle) for angle in (1, 2, 10, 20)),
        Protocol("borer-6dof", "fibonacci 0.5deg 0.25m", _SINGLE, _BORER, _BORER_FRAMES, {"hit_rate": (0.5, 0.2)}),
    )
}
"""Every protocol by name."""


def protocol_of(name: str, where: object = None) -> Protocol:
    """Return the protocol of a name; raises UnknownNameError with the nearest names."""
    if name not in PROTOCOLS:
        raise UnknownNameError("protocol", name, PROTOCOLS, where=where)
    return PROTOCOLS[name]


def figures_text(protocol: Protocol, figures: Mapping[str, float]) -> str:
    """Format figures as one line: deg and m with fixed digits, shares in percent."""
    shares = {name: f"{100 * value:.0f} %" for name, value in figures.items() if name in protocol.limits}
    texts = (f"{name} {shares.get(name, f'{value:.3f}')}" for name, value in figures.items())
    return f"protocol {protocol.name}: " + ", ".join(texts)
