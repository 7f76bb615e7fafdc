"""Whether every figure of a certificate is what its inputs give: comparison of two certificates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.results.origin import digest

# What may differ between two computations of the same: neither is a figure of the calibration.
NOT_FIGURES = ("run_files", "documents", "iterations", "source", "result_sha256")
# Two machines sum in another order; a value may differ by this share of its standard deviation ...
SHARE_OF_SIGMA = 1e-4
# ... any other number by this share of itself, or, in metres, pixels and correlations, by this much.
RELATIVE, ABSOLUTE = 1e-6, 1e-8
# Figures of the analysis are differences of two adjustments, each of which ends within a millionth of a
# standard deviation of its minimum: four digits of them are the same everywhere ...
ANALYSIS, ANALYSIS_RELATIVE = "analysis", 1e-4
# ... and those that may be nearly zero, in millimetres, metres, pixels or as correlations, to this much.
NEARLY_ZERO = ("c", "change_of_c", "value", "check_rmse_m", "shift_c", "bias", "ground_m", "effect_c")
ANALYSIS_ABSOLUTE = 1e-6


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out as certified: where in the certificate, and both values."""

    place: str
    certified: Any
    found: Any


def changed_documents(certificate: dict[str, Any], folder: Path) -> list[str]:
    """Name the printed forms beside a certificate that are not the certified ones; a missing one may be.

    Parameters
    ----------
    certificate : dict
        Machine-readable certificate.
    folder : Path
        The folder of the certificate.

    Returns
    -------
    list of str
        One phrase for each that has changed.
    """
    present = {Path(name).name: sha for name, sha in certificate["documents"].items()}
    return [
        f"{name} is not the one that was certified"
        for name, sha in present.items()
        if (folder / name).is_file() and digest(folder / name) != sha
    ]


def differences(certified: Any, found: Any, place: str = "", sigma: float = 0.0) -> list[Difference]:
    """Compare two certificates figure by figure.

    Parameters
    ----------
    certified, found : dict, list or plain value
        The certificate, and the same made anew.
    place : str
        Where they stand, for the answer.
    sigma : float
        Standard deviation of the value, if it stands beside one.

    Returns
    -------
    list of Difference
        Empty when every figure is the same.
    """
    if isinstance(certified, dict) and isinstance(found, dict):
        return _in_mappings(certified, found, place)
    if isinstance(certified, list) and isinstance(found, list) and len(certified) == len(found):
        pairs = enumerate(zip(certified, found, strict=True))
        return [d for i, (a, b) in pairs for d in differences(a, b, f"{place}[{_name(a, i)}]")]
    return [] if _same(certified, found, place, sigma) else [Difference(place, certified, found)]


def _in_mappings(certified: dict[str, Any], found: dict[str, Any], place: str) -> list[Difference]:
    missing = object()
    listed = []
    sigma = certified.get("sigma")
    for key in dict.fromkeys([*certified, *found]):
        if key in NOT_FIGURES:
            continue
        a, b = certified.get(key, missing), found.get(key, missing)
        where = f"{place}.{key}" if place else key
        if a is missing or b is missing:
            listed.append(Difference(where, _or_none(a, missing), _or_none(b, missing)))
            continue
        spread = float(sigma) if key == "value" and isinstance(sigma, int | float) else 0.0
        listed += differences(a, b, where, spread)
    return listed


def _or_none(value: Any, missing: object) -> Any:
    return None if value is missing else value


def _name(item: Any, index: int) -> str:
    """An entry of a list by what it is called, if it is."""
    if isinstance(item, dict):
        for key in ("image", "path", "point", "key", "name", "kind", "method", "code"):
            if isinstance(item.get(key), str):
                return str(item[key])
    return str(index)


def _same(certified: Any, found: Any, place: str, sigma: float) -> bool:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (certified, found))
    if not numbers:
        return bool(certified == found)
    return bool(abs(certified - found) <= _tolerance(place, max(abs(certified), abs(found)), sigma))


def _tolerance(place: str, size: float, sigma: float) -> float:
    """By how much two computations of a figure may differ."""
    if sigma > 0.0:
        return max(SHARE_OF_SIGMA * sigma, 1e-12 * size)
    key = place.rsplit(".", 1)[-1].split("[")[0]
    if place.startswith(ANALYSIS):
        return max(ANALYSIS_RELATIVE * size, ANALYSIS_ABSOLUTE if key in NEARLY_ZERO else 0.0)
    # Coefficients may be as small as 1e-20: only figures of known size have an absolute tolerance.
    known = key not in ("sigma", "value", "prior_sigma")
    return max(RELATIVE * size, ABSOLUTE if known else 0.0)
