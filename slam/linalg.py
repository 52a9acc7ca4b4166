"""The only home of small-matrix algebra: 2x2 and 3x3, in closed form, on nested tuples of floats.

Tuples are values: nothing is allocated, nothing is shared, and the compiler keeps them in registers.  Matrices are
tuples of rows.  Everything is float64: with a sensor of 0.3 mm at 40 m, entries of 1e-8 stand beside 1.
"""

from __future__ import annotations

import math
from typing import Any

from slam._jit import inline
from slam.geometry import wrap

LOG_TWO_PI = math.log(2.0 * math.pi)


@inline
def load3(a: Any) -> Any:
    """(3,) array -> tuple."""
    return (a[0], a[1], a[2])


@inline
def load22(A: Any) -> Any:
    """(2, 2) array -> tuple of rows."""
    return ((A[0, 0], A[0, 1]), (A[1, 0], A[1, 1]))


@inline
def load33(A: Any) -> Any:
    """(3, 3) array -> tuple of rows."""
    return ((A[0, 0], A[0, 1], A[0, 2]), (A[1, 0], A[1, 1], A[1, 2]), (A[2, 0], A[2, 1], A[2, 2]))


@inline
def store3(out: Any, a: Any) -> None:
    """Tuple -> (3,) array."""
    out[0], out[1], out[2] = a


@inline
def store22(out: Any, A: Any) -> None:
    """Tuple of rows -> (2, 2) array."""
    (out[0, 0], out[0, 1]), (out[1, 0], out[1, 1]) = A


@inline
def store33(out: Any, A: Any) -> None:
    """Tuple of rows -> (3, 3) array."""
    for i in range(3):
        out[i, 0], out[i, 1], out[i, 2] = A[i]


@inline
def add22(A: Any, B: Any) -> Any:
    """A + B."""
    return ((A[0][0] + B[0][0], A[0][1] + B[0][1]), (A[1][0] + B[1][0], A[1][1] + B[1][1]))


@inline
def dot2(a: Any, b: Any) -> Any:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1]


@inline
def dot3(a: Any, b: Any) -> Any:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def times22(A: Any, b: Any) -> Any:
    """A b for a 2x2 A."""
    return (dot2(A[0], b), dot2(A[1], b))


@inline
def times33(A: Any, b: Any) -> Any:
    """A b for a 3x3 A."""
    return (dot3(A[0], b), dot3(A[1], b), dot3(A[2], b))


@inline
def sandwich22(G: Any, S: Any) -> Any:
    """G S G^T for 2x2 G and symmetric 2x2 S, exactly symmetric."""
    w0, w1 = times22(S, G[0]), times22(S, G[1])
    off = dot2(G[0], w1)
    return ((dot2(G[0], w0), off), (off, dot2(G[1], w1)))


@inline
def sandwich23(G: Any, P: Any) -> Any:
    """G P G^T for 2x3 G and symmetric 3x3 P, exactly symmetric."""
    w0, w1 = times33(P, G[0]), times33(P, G[1])
    off = dot3(G[0], w1)
    return ((dot3(G[0], w0), off), (off, dot3(G[1], w1)))


@inline
def cross23(A: Any, P: Any, B: Any) -> Any:
    """A P B^T for 2x3 A, B and symmetric 3x3 P: the covariance of two innovations that share a pose."""
    w0, w1 = times33(P, B[0]), times33(P, B[1])
    return ((dot3(A[0], w0), dot3(A[0], w1)), (dot3(A[1], w0), dot3(A[1], w1)))


@inline
def sandwich33(H: Any, P: Any) -> Any:
    """H P H^T for 3x3 H and symmetric 3x3 P, exactly symmetric."""
    w0, w1, w2 = times33(P, H[0]), times33(P, H[1]), times33(P, H[2])
    p01, p02, p12 = dot3(H[0], w1), dot3(H[0], w2), dot3(H[1], w2)
    return ((dot3(H[0], w0), p01, p02), (p01, dot3(H[1], w1), p12), (p02, p12, dot3(H[2], w2)))


@inline
def add_outer_scaled(P: Any, H: Any, deviation: Any) -> Any:
    """P + H diag(deviation^2) H^T for 3xm H and an array of m deviations, exactly symmetric."""
    (p00, p01, p02), (_, p11, p12), (_, _, p22) = P
    for j in range(len(deviation)):
        q = deviation[j] * deviation[j]
        a, b, c = H[0][j], H[1][j], H[2][j]
        p00 += a * a * q
        p01 += a * b * q
        p02 += a * c * q
        p11 += b * b * q
        p12 += b * c * q
        p22 += c * c * q
    return ((p00, p01, p02), (p01, p11, p12), (p02, p12, p22))


@inline
def determinant22(V: Any) -> Any:
    """|V|."""
    return V[0][0] * V[1][1] - V[0][1] * V[1][0]


@inline
def largest_eigenvalue22(A: Any) -> Any:
    """The largest eigenvalue of the leading 2x2 block of a symmetric, positive semidefinite A."""
    return 0.5 * (A[0][0] + A[1][1]) + math.hypot(0.5 * (A[0][0] - A[1][1]), A[0][1])


@inline
def inverse22(V: Any) -> Any:
    """V^-1 of a regular V."""
    scale = 1.0 / determinant22(V)
    return ((V[1][1] * scale, -V[0][1] * scale), (-V[1][0] * scale, V[0][0] * scale))


@inline
def distance2(v: Any, V: Any) -> Any:
    """The squared Mahalanobis distance v^T V^-1 v (25)."""
    return dot2(v, times22(inverse22(V), v))


@inline
def log_density(v: Any, V: Any) -> Any:
    """log N(v; 0, V) in two dimensions (43).  The paper prints the determinant without its square root."""
    return -LOG_TWO_PI - 0.5 * math.log(determinant22(V)) - 0.5 * distance2(v, V)


@inline
def kalman_pose(s: Any, P: Any, v: Any, G: Any, R: Any, V: Any) -> Any:
    """EKF update (28) of a pose (s, P) by an innovation v with Jacobian G (2x3); V = G P G^T + R.

    Joseph form, (I - K G) P (I - K G)^T + K R K^T, which stays positive semidefinite when P and R differ by 1e8.
    """
    W = (times33(P, G[0]), times33(P, G[1]))  # rows of (P G^T)^T
    Vi = inverse22(V)
    K = (
        times22(Vi, (W[0][0], W[1][0])),
        times22(Vi, (W[0][1], W[1][1])),
        times22(Vi, (W[0][2], W[1][2])),
    )  # P G^T V^-1, V^-1 being symmetric
    s_new = (s[0] + dot2(K[0], v), s[1] + dot2(K[1], v), wrap(s[2] + dot2(K[2], v)))
    G0, G1, G2 = (G[0][0], G[1][0]), (G[0][1], G[1][1]), (G[0][2], G[1][2])  # columns
    A = (
        (1.0 - dot2(K[0], G0), -dot2(K[0], G1), -dot2(K[0], G2)),
        (-dot2(K[1], G0), 1.0 - dot2(K[1], G1), -dot2(K[1], G2)),
        (-dot2(K[2], G0), -dot2(K[2], G1), 1.0 - dot2(K[2], G2)),
    )
    (a00, a01, a02), (_, a11, a12), (_, _, a22) = sandwich33(A, P)
    r0, r1, r2 = times22(R, K[0]), times22(R, K[1]), times22(R, K[2])
    p00, p01, p02 = a00 + dot2(K[0], r0), a01 + dot2(K[0], r1), a02 + dot2(K[0], r2)
    p11, p12, p22 = a11 + dot2(K[1], r1), a12 + dot2(K[1], r2), a22 + dot2(K[2], r2)
    return s_new, ((p00, p01, p02), (p01, p11, p12), (p02, p12, p22))


@inline
def kalman_feature(Sigma: Any, v: Any, G: Any, R: Any, V: Any) -> Any:
    """EKF update of a feature's two uncertain coordinates: the displacement (2,) and the new Sigma (Joseph form)."""
    W = (times22(Sigma, G[0]), times22(Sigma, G[1]))
    Vi = inverse22(V)
    K = (times22(Vi, (W[0][0], W[1][0])), times22(Vi, (W[0][1], W[1][1])))
    G0, G1 = (G[0][0], G[1][0]), (G[0][1], G[1][1])
    A = ((1.0 - dot2(K[0], G0), -dot2(K[0], G1)), (-dot2(K[1], G0), 1.0 - dot2(K[1], G1)))
    return times22(K, v), add22(sandwich22(A, Sigma), sandwich22(K, R))


@inline
def factor22(A: Any) -> Any:
    """Lower L with L L^T = A for a positive *semi*definite A: a pivot lost in rounding becomes a zero column."""
    l00 = math.sqrt(max(A[0][0], 0.0))
    l10 = A[1][0] / l00 if l00 > 0.0 else 0.0
    rest = A[1][1] - l10 * l10
    l11 = math.sqrt(rest) if rest > 1e-15 * A[1][1] else 0.0
    return ((l00, 0.0), (l10, l11))


@inline
def factor33(A: Any) -> Any:
    """Lower L with L L^T = A for a positive *semi*definite A; P is of rank 2 after one control tick."""
    l00 = math.sqrt(max(A[0][0], 0.0))
    l10 = A[1][0] / l00 if l00 > 0.0 else 0.0
    l20 = A[2][0] / l00 if l00 > 0.0 else 0.0
    rest = A[1][1] - l10 * l10
    l11 = math.sqrt(rest) if rest > 1e-15 * A[1][1] else 0.0
    l21 = (A[2][1] - l20 * l10) / l11 if l11 > 0.0 else 0.0
    rest = A[2][2] - l20 * l20 - l21 * l21
    l22 = math.sqrt(rest) if rest > 1e-15 * A[2][2] else 0.0
    return ((l00, 0.0, 0.0), (l10, l11, 0.0), (l20, l21, l22))
