"""Scale between ground and map, against published worked examples."""

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.geometry.frames import combined_factor, ground_scale, reference_frame

# UTM of zone 18 on Clarke's ellipsoid of 1866, as in the example of Snyder.
CLARKE_18 = "+proj=utm +zone=18 +ellps=clrk66 +type=crs"


def test_the_point_factor_is_that_of_snyders_example() -> None:
    """Snyder (1987), USGS Professional Paper 1395, page 269: 40.5 N 73.5 W, k = 0.9997989."""
    place = np.array([[627106.5, 4484124.4, 0.0]])
    found = ground_scale(CLARKE_18, place)
    assert found.point_factor == pytest.approx([0.9997989], abs=5e-8)
    assert found.elevation_factor == pytest.approx([1.0], abs=1e-12)


def test_the_elevation_factor_is_that_of_the_state_plane_manual() -> None:
    """Stem (1989), NOAA Manual NOS NGS 5, section 4.2: R / (R + h) with R = 6 372 000 m."""
    place = np.array([[500000.0, 4_427_757.0, 1500.0]])
    factor = ground_scale("EPSG:26918", place).elevation_factor
    assert factor == pytest.approx([6_372_000 / 6_373_500], abs=2e-7)


def test_a_distance_on_the_ground_times_the_factor_is_that_of_the_map() -> None:
    """Chords at 1100 m, from geocentric coordinates: both directions' mean is Gauss's mean radius."""
    crs, middle = "EPSG:31982", np.array([677_000.0, 7_184_000.0, 1100.0])
    frame = reference_frame(crs, "ellipsoidal", middle)
    ratios = []
    for way in (np.array([200.0, 0.0, 0.0]), np.array([0.0, 200.0, 0.0])):
        one, other = frame.to_given(np.array([-way, way]))
        ratios.append(np.linalg.norm((other - one)[:2]) / 400.0)
    assert np.sqrt(np.prod(ratios)) == pytest.approx(combined_factor(crs, middle[None])[0], rel=1e-8)


def test_what_is_no_map_has_no_scale() -> None:
    """Degrees have no scale."""
    with pytest.raises(ConfigurationError, match="not a map system"):
        combined_factor("EPSG:4674", np.array([[-25.0, -49.0, 0.0]]))
