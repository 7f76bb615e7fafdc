"""From the reduced system back to the points, and from the points to the reduced system."""

from photocal.adjustment.kernels.data import Design, Eliminated, Structure, columns
from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, each_piece


@compiled
def back_substitute_piece(
    design: Design, structure: Structure, step: Floats, kept: Eliminated, piece: int, points: Floats
) -> float:
    """Move one piece's points; returns g'V^-1 g, see `back_substitute`."""
    decrease, band = 0.0, structure.band
    for j in range(design.spans[piece], design.spans[piece + 1]):
        g0, g1, g2 = kept.gradient[j, 0], kept.gradient[j, 1], kept.gradient[j, 2]
        c0, c1, c2 = g0, g1, g2
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            column = design.image_column[design.ray_image[r]]
            for b in range(columns(design)):
                c0 += kept.mixed[r, 0, b] * step[column + b]
                c1 += kept.mixed[r, 1, b] * step[column + b]
                c2 += kept.mixed[r, 2, b] * step[column + b]
        for s in range(structure.lens):
            c0 += kept.mixed_border[j, 0, s] * step[band + s]
            c1 += kept.mixed_border[j, 1, s] * step[band + s]
            c2 += kept.mixed_border[j, 2, s] * step[band + s]
        for a in range(3):
            q0, q1, q2 = kept.inverse[j, a, 0], kept.inverse[j, a, 1], kept.inverse[j, a, 2]
            points[j, a] -= q0 * c0 + q1 * c1 + q2 * c2
            decrease += kept.gradient[j, a] * (q0 * g0 + q1 * g1 + q2 * g2)
    return decrease


def back_substitute(
    design: Design, structure: Structure, step: Floats, kept: Eliminated, points: Floats, decreases: Floats
) -> None:
    """Move the points by the steps that belong to a step of the reduced system."""

    def work(piece: int) -> None:
        """The points of one piece; pieces run side by side."""
        decreases[piece] = back_substitute_piece(design, structure, step, kept, piece, points)

    each_piece(len(decreases), work)


@compiled
def reduce_right_piece(
    design: Design, structure: Structure, right: Floats, kept: Eliminated, piece: int, reduced: Floats
) -> None:
    """Eliminate one piece's points, see `reduce_right`."""
    band = structure.band
    for j in range(design.spans[piece], design.spans[piece + 1]):
        b0, b1, b2 = right[j, 0], right[j, 1], right[j, 2]
        for a in range(3):
            x = kept.inverse[j, a, 0] * b0 + kept.inverse[j, a, 1] * b1 + kept.inverse[j, a, 2] * b2
            if x == 0.0:
                continue
            for r in range(design.ray_start[j], design.ray_start[j + 1]):
                column = design.image_column[design.ray_image[r]]
                for b in range(columns(design)):
                    reduced[column + b] -= kept.mixed[r, a, b] * x
            for s in range(structure.lens):
                reduced[band + s] -= kept.mixed_border[j, a, s] * x


def reduce_right(
    design: Design, structure: Structure, right: Floats, kept: Eliminated, reduced: Floats
) -> None:
    """Eliminate the points from a right-hand side: what each piece takes off, (pieces, layout.size)."""

    def work(piece: int) -> None:
        """The points of one piece; pieces run side by side."""
        reduce_right_piece(design, structure, right, kept, piece, reduced[piece])

    each_piece(len(reduced), work)
