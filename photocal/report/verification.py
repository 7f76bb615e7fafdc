"""Whether every figure of a certificate is what its inputs give: comparison of two certificates."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# What may differ between two computations of the same: neither is a figure of the calibration.
NOT_FIGURES = ("run_files", "documents", "iterations")
# Two machines sum in another order; a value may differ by this share of its standard deviation ...
SHARE_OF_SIGMA = 1e-4
# ... any other number by this share of itself, or, in metres, pixels and correlations, by this much.
RELATIVE, ABSOLUTE = 1e-6, 1e-8


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out as certified: where in the certificate, and both values."""

    place: str
    certified: Any
    found: Any


def changed_inputs(certificate: dict[str, Any], folder: Path) -> list[str]:
    """Name the inputs that are not the certified ones.

    Parameters
    ----------
    certificate : dict
        Machine-readable certificate.
    folder : Path
        Where the inputs lie.

    Returns
    -------
    list of str
        One phrase for each input that is missing or changed.
    """
    phrases = []
    for entry in certificate["result"]["inputs"]:
        path = folder / entry["path"]
        if not path.is_file():
            phrases.append(f"{entry['path']} is missing")
        elif (found := digest(path)) != entry["sha256"]:
            phrases.append(
                f"{entry['path']} has changed (SHA-256 {found[:12]}..., certified {entry['sha256'][:12]}...)"
            )
    return phrases


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


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
        for key in ("image", "path", "point", "key", "name"):
            if isinstance(item.get(key), str):
                return str(item[key])
    return str(index)


def _same(certified: Any, found: Any, place: str, sigma: float) -> bool:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (certified, found))
    if not numbers:
        return bool(certified == found)
    tolerance = RELATIVE * max(abs(certified), abs(found))
    if sigma > 0.0:
        tolerance = max(SHARE_OF_SIGMA * sigma, 1e-12 * abs(certified))
    elif not place.endswith((".sigma", ".value", ".prior_sigma")):
        # Coefficients may be as small as 1e-20: only figures of known size have an absolute tolerance.
        tolerance = max(tolerance, ABSOLUTE)
    return bool(abs(certified - found) <= tolerance)
