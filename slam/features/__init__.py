"""Feature kinds behind one innovation-valued interface.

A kind is a `NamedTuple` class; its instance travels in the `Frame` and tells compiled kernels, at compile time, which
mathematics to use.  It has these static functions over scalars and tuples (plain Python too, so tests can call them):

    innovation(feature, theta, s, z) -> v (2,), G_s (2, 3), G_theta (2, 2)
    inverse(feature, s, z)           -> theta (D,), F_s (2, 3), F_z (2, 2)
    draw(feature, theta, delta)      -> theta displaced by delta (2,) in the two coordinates that are uncertain
    total(feature, R, G_theta, model)-> R of an observation that is paired with a feature: with the error of the model
    observable(feature, s, P, z, v, G_s, R)
                                     -> G_s of a particle, by which z tells nothing that it does not show
    displacement(feature, s, P, z, V, R, normal)
                                     -> delta (2,) of N(0, V) by which a new feature is drawn, from normal (2,)
    extent(feature, theta)           -> (x_min, y_min, x_max, y_max) [m], for the search over the map
    spread(feature, theta, Sigma)    -> the largest deviation [m] that Sigma gives any part of it, for the search
    compatible(feature, theta, s, P, z)
                                     -> whether z may be of it, beside what the distance (25) says
    extend(feature, theta, s, z)     -> theta with what z shows of it that is not uncertain: how far a wall reaches
    region(feature, s, P, z, R, model, reach)
                                     -> such a box, and how far beyond it a feature with Sigma may stand, for each
                                        metre of its deviation (`spread`): no compatible feature outside has a distance
                                        (25) <= reach^2

and, where `merges` is true, two of a kind of feature that may turn out to be one:

    distance(feature, theta, Sigma, other, Sigma_other, s, z, model)
                                     -> squared, of the other from theta beside z, that may be of both; infinite where
                                        something that was seen says that they are two
    united(feature, theta, Sigma, other, Sigma_other)
                                     -> theta, Sigma of the two as one, in the frame of the first

`v = z - g(s, theta)` (23), with G_s = dg/ds and G_theta = dg/dtheta (24); F_s and F_z are those of (35).  The two
columns of G_theta and rows of F_s are the coordinates that `Sigma` and `draw` speak of: for a point (x, y), for a wall
its lateral offset and its angle.  Class attributes: `dim` = D numbers that describe a feature, `observation` = d
numbers of one observation, `grows` = whether `extend` does anything, `merges`; and
believed(z (Z, d), params) -> `ObservationNoise`, the honest one; of_known(R, params) -> that for known features.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from slam._jit import inline
from slam.features.point import Point
from slam.features.wall import Wall
from slam.linalg import add22, sandwich22

__all__ = [
    "Point",
    "Wall",
    "compatible",
    "displacement",
    "distance",
    "draw",
    "extend",
    "extent",
    "innovation",
    "inverse",
    "measurement",
    "observable",
    "region",
    "spread",
    "total",
    "united",
]


def innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
    """v (2,), G_s (2, 3), G_theta (2, 2) of one observation paired with one feature (23, 24)."""
    return type(feature).innovation(feature, theta, s, z)


def observable(feature: Any, s: Any, P: Any, z: Any, v: Any, G_s: Any, R: Any) -> Any:
    """G_s (2, 3) that gives a particle N(s, P) no information on what z does not show."""
    return type(feature).observable(feature, s, P, z, v, G_s, R)


def displacement(feature: Any, s: Any, P: Any, z: Any, V: Any, R: Any, normal: Any) -> Any:
    """delta (2,) of N(0, V), V = F_s P F_s^T + F_z R F_z^T, by which a new feature is drawn (34)."""
    return type(feature).displacement(feature, s, P, z, V, R, normal)


def inverse(feature: Any, s: Any, z: Any) -> Any:
    """theta (D,), F_s (2, 3), F_z (2, 2) of the feature that one observation creates (33, 35)."""
    return type(feature).inverse(feature, s, z)


def draw(feature: Any, theta: Any, delta: Any) -> Any:
    """The feature displaced by delta (2,) in its uncertain coordinates."""
    return type(feature).draw(feature, theta, delta)


def extent(feature: Any, theta: Any) -> Any:
    """(x_min, y_min, x_max, y_max) [m] that the feature covers."""
    return type(feature).extent(feature, theta)


def total(feature: Any, R: Any, G_theta: Any, model: Any) -> Any:
    """R (2, 2) of an observation that is paired with a feature: its own, and what the feature's model leaves out."""
    return type(feature).total(feature, R, G_theta, model)


def spread(feature: Any, theta: Any, Sigma: Any) -> Any:
    """[m] the largest deviation that Sigma gives any part of a feature."""
    return type(feature).spread(feature, theta, Sigma)


def compatible(feature: Any, theta: Any, s: Any, P: Any, z: Any) -> Any:
    """Whether z, seen from N(s, P), may be of the feature, beside what the distance (25) says."""
    return type(feature).compatible(feature, theta, s, P, z)


def extend(feature: Any, theta: Any, s: Any, z: Any) -> Any:
    """The feature with what z shows of it that is not uncertain."""
    return type(feature).extend(feature, theta, s, z)


def region(feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any, reach: Any) -> Any:
    """Where z may be of a feature: (x_min, y_min, x_max, y_max) [m], and metres more for each metre of deviation."""
    return type(feature).region(feature, s, P, z, R, model, reach)


def distance(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any, s: Any, z: Any, model: Any) -> Any:
    """The squared distance of two features beside z, that may be of both; infinite where they are two."""
    return type(feature).distance(feature, theta, Sigma, other, Sigma_other, s, z, model)


def united(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any) -> Any:
    """theta and Sigma of two features that are one, in the frame of the first."""
    return type(feature).united(feature, theta, Sigma, other, Sigma_other)


@overload(innovation)
def _innovation(feature: Any, theta: Any, s: Any, z: Any) -> Any:
    return feature.instance_class.innovation


@overload(observable)
def _observable(feature: Any, s: Any, P: Any, z: Any, v: Any, G_s: Any, R: Any) -> Any:
    return feature.instance_class.observable


@overload(displacement)
def _displacement(feature: Any, s: Any, P: Any, z: Any, V: Any, R: Any, normal: Any) -> Any:
    return feature.instance_class.displacement


@overload(inverse)
def _inverse(feature: Any, s: Any, z: Any) -> Any:
    return feature.instance_class.inverse


@overload(draw)
def _draw(feature: Any, theta: Any, delta: Any) -> Any:
    return feature.instance_class.draw


@overload(extent)
def _extent(feature: Any, theta: Any) -> Any:
    return feature.instance_class.extent


@overload(total)
def _total(feature: Any, R: Any, G_theta: Any, model: Any) -> Any:
    return feature.instance_class.total


@overload(spread)
def _spread(feature: Any, theta: Any, Sigma: Any) -> Any:
    return feature.instance_class.spread


@overload(compatible)
def _compatible(feature: Any, theta: Any, s: Any, P: Any, z: Any) -> Any:
    return feature.instance_class.compatible


@overload(extend)
def _extend(feature: Any, theta: Any, s: Any, z: Any) -> Any:
    return feature.instance_class.extend


@overload(region)
def _region(feature: Any, s: Any, P: Any, z: Any, R: Any, model: Any, reach: Any) -> Any:
    return feature.instance_class.region


@overload(distance)
def _distance(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any, s: Any, z: Any, model: Any) -> Any:
    return feature.instance_class.distance


@overload(united)
def _united(feature: Any, theta: Any, Sigma: Any, other: Any, Sigma_other: Any) -> Any:
    return feature.instance_class.united


@inline
def measurement(feature: Any, theta: Any, Sigma: Any, s: Any, P: Any, z: Any, R: Any, model: Any) -> Any:
    """v, G_s and S = G_theta Sigma G_theta^T + R in all (2, 2), of one observation and a feature of a particle's map.

    The pose is N(s, P), so that V = G_s P G_s^T + S.
    """
    v, G_s, G_theta = innovation(feature, theta, s, z)
    S = add22(sandwich22(G_theta, Sigma), total(feature, R, G_theta, model))
    return v, observable(feature, s, P, z, v, G_s, S), S
