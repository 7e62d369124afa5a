"""What matchers and initializers are given: views of the stage that hold the kinds of features that they need."""

from __future__ import annotations

from typing import Any

from p2o.errors import MethodUnavailable
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.host.guard import build
from p2o.host.method import Kind
from p2o.host.registry import Offer
from p2o.testing import stage
from p2o.testing.subject import NotApplicable, Subject, lacking

_PREFIXES = ("image-", "cloud-")


def view(subject: Subject) -> View:
    """Return the stage with the kinds of features that the method needs, all that it has where none is named.

    They are exact, but for kinds that only plugins know: those are found by an extractor that gives them.
    """
    return _as_pipeline(subject, subject.once(_full))


def bare_view(subject: Subject) -> View:
    """Return what `view` is where there is nothing to be found."""
    return _as_pipeline(subject, subject.once(_bare))


def _as_pipeline(subject: Subject, found: View) -> View:
    """Return the view as the pipeline would hand it over: without sides where the method does not ask for them."""
    sided = "side" in subject.needs or subject.offer.kind == Kind.INITIALIZER
    return found if sided else found.without_sides()


def _full(subject: Subject) -> View:
    frame = stage.frame()
    return _view(subject, stage.view(), {"image-": frame.image, "cloud-": frame.cloud})


def _bare(subject: Subject) -> View:
    nothing = {"image-": stage.featureless_image(), "cloud-": stage.featureless_cloud()}
    return _view(subject, stage.bare_view(), nothing)


def _view(subject: Subject, known: View, seen: dict[str, Any]) -> View:
    words = sorted(word for word in subject.needs if word.startswith(_PREFIXES))
    if not words:
        return known
    found = []
    for word in words:
        feature = known.get(word)
        found.append(_by_a_plugin(subject, word, seen[word[:6]]) if feature is None else feature)
    image = ImageFeatures(features=[f for f in found if f.word.startswith("image-")])
    cloud = CloudFeatures(features=[f for f in found if f.word.startswith("cloud-")])
    return View(known.name, known.camera, image, cloud)


def _by_a_plugin(subject: Subject, word: str, seen: Any) -> Any:
    """Return the features of a kind that an installed extractor finds, first of all one of the same plugin.

    Raises NotApplicable where there is none.
    """
    kind = Kind.IMAGE_EXTRACTOR if word.startswith("image-") else Kind.CLOUD_EXTRACTOR

    def foreign(offer: Offer) -> bool:
        return (offer.dist, offer.entry) != (subject.offer.dist, subject.offer.entry)

    givers = [offer for offer in subject.registry.of_kind(kind) if word in offer.method.gives]
    for offer in sorted(givers, key=foreign):
        if lacking(offer.method.needs, (stage.frame(),)):
            continue
        try:
            return build(offer, offer.method.options())(seen).get(word)
        except MethodUnavailable:
            continue
    raise NotApplicable(f"no installed extractor gives {word}")
