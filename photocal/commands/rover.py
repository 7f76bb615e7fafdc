"""`photocal rover-test`: whether a GNSS rover is as good as it is said to be, before control is believed."""

from pathlib import Path
from typing import Annotated

from photocal.base.console import AsJson, answer, argument, numbers_of, option


def rover_test(
    sets: Annotated[Path, argument("CSV of the measured sets: series, set, point, E, N, h (m).")],
    distance: Annotated[float, option("Known horizontal distance of both rover points, m.")],
    height_difference: Annotated[float, option("Known height of the second point over the first, m.")],
    sigma: Annotated[str, option("Stated standard deviations of the rover: PLANE,HEIGHT, m.")],
    earlier: Annotated[str, option("Standard deviations of an earlier full test: PLANE,HEIGHT, m.")] = "",
    as_json: AsJson = False,
) -> None:
    """Test a GNSS rover (RTK) in the field after ISO 17123-8, simplified or full.

    One series of five sets makes the simplified test, three series the full one: standard deviations in plane
    and height, held against the stated ones (chi-squared) and an earlier test (F). `photocal forms --kinds
    rover` prints the sheet.

    Example: `photocal rover-test sets.csv --distance 12.345 --height-difference 0.214 --sigma 0.010,0.015`
    """
    from photocal.accuracy import rover_test as test

    form = "PLANE,HEIGHT: metres, such as 0.010,0.015"
    plane, height = numbers_of(sigma, "--sigma", form)
    before = None
    if earlier:
        plane_before, height_before = numbers_of(earlier, "--earlier", form)
        before = plane_before, height_before
    made = test.rover_test(test.read_sets(sets), distance, height_difference, plane, height, before)
    answer(as_json, lambda: test.as_record(made), lambda: test.as_text(made))
