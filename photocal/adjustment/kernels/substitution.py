"""From the reduced system back to the points, and from the points to the reduced system."""

from photocal.adjustment.kernels.data import Design, Eliminated, Structure, columns
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, each_piece


@compiled
def back_substitute_piece(
    design: Design,
    structure: Structure,
    step: Floats,
    kept: Eliminated,
    gradient: Floats,
    piece: int,
    points: Floats,
) -> float:
    """Move one piece's points; returns g'V^-1 g, see `back_substitute`."""
    decrease, band = 0.0, structure.band
    for j in range(design.spans[piece], design.spans[piece + 1]):
        # What is kept of a point stays near the processor until all steps have used it.
        for t in range(len(step)):
            g0, g1, g2 = gradient[t, j, 0], gradient[t, j, 1], gradient[t, j, 2]
            c0, c1, c2 = g0, g1, g2
            for r in range(design.ray_start[j], design.ray_start[j + 1]):
                column = design.image_column[design.ray_image[r]]
                for b in range(columns(design)):
                    c0 += kept.mixed[r, 0, b] * step[t, column + b]
                    c1 += kept.mixed[r, 1, b] * step[t, column + b]
                    c2 += kept.mixed[r, 2, b] * step[t, column + b]
            for s in range(structure.lens):
                c0 += kept.mixed_border[j, 0, s] * step[t, band + s]
                c1 += kept.mixed_border[j, 1, s] * step[t, band + s]
                c2 += kept.mixed_border[j, 2, s] * step[t, band + s]
            for a in range(3):
                q0, q1, q2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
                points[t, j, a] -= q0 * c0 + q1 * c1 + q2 * c2
                decrease += gradient[t, j, a] * (q0 * g0 + q1 * g1 + q2 * g2)
    return decrease


def back_substitute(
    design: Design, structure: Structure, step: Floats, kept: Eliminated, gradient: Floats, points: Floats
) -> float:
    """Move the points by the steps that belong to a step of the reduced system, or to several.

    step (n,) or (t, n); gradient, points (points, 3) or (t, points, 3).
    returns g'V^-1 g: what v'Pv falls by for the points' own sake.
    """
    decreases = [0.0] * (len(design.pieces) - 1)
    step, gradient, points = (
        one.reshape(-1, *one.shape[-axes:]) for one, axes in ((step, 1), (gradient, 2), (points, 2))
    )

    def work(piece: int) -> None:
        """The points of one piece; pieces run side by side."""
        decreases[piece] = back_substitute_piece(design, structure, step, kept, gradient, piece, points)

    each_piece(len(decreases), work)
    return sum(decreases)


@compiled
def reduce_right_piece(
    design: Design, structure: Structure, right: Floats, kept: Eliminated, piece: int, reduced: Floats
) -> None:
    """Eliminate one piece's points, see `reduce_right`."""
    band, (mixed, mixed_border, inverse, _, _) = structure.band, kept
    for j in range(design.spans[piece], design.spans[piece + 1]):
        for t in range(len(right)):
            b0, b1, b2 = right[t, j, 0], right[t, j, 1], right[t, j, 2]
            if b0 == 0.0 and b1 == 0.0 and b2 == 0.0:
                continue
            x0 = inverse[j, 0, 0] * b0 + inverse[j, 0, 1] * b1 + inverse[j, 0, 2] * b2
            x1 = inverse[j, 1, 0] * b0 + inverse[j, 1, 1] * b1 + inverse[j, 1, 2] * b2
            x2 = inverse[j, 2, 0] * b0 + inverse[j, 2, 1] * b1 + inverse[j, 2, 2] * b2
            for r in range(design.ray_start[j], design.ray_start[j + 1]):
                column = design.image_column[design.ray_image[r]]
                for b in range(columns(design)):
                    less = mixed[r, 0, b] * x0 + mixed[r, 1, b] * x1 + mixed[r, 2, b] * x2
                    reduced[t, column + b] -= less
            for s in range(structure.lens):
                less = mixed_border[j, 0, s] * x0 + mixed_border[j, 1, s] * x1 + mixed_border[j, 2, s] * x2
                reduced[t, band + s] -= less


def reduce_right(
    design: Design, structure: Structure, right: Floats, kept: Eliminated, reduced: Floats
) -> None:
    """Eliminate the points from several right-hand sides.

    right (t, points, 3); reduced (pieces, t, layout.size): receives what each piece takes off.
    """

    def work(piece: int) -> None:
        """The points of one piece; pieces run side by side."""
        reduce_right_piece(design, structure, right, kept, piece, reduced[piece])

    each_piece(len(reduced), work)
