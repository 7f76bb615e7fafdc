"""An assessment as a JSON value (schema `photocal.check/2`)."""

from __future__ import annotations

import math
from typing import Any

from photocal.accuracy.assessment import Assessment, ComponentResult, TableResult, VectorResult
from photocal.accuracy.classes import AdmittedSize, ClassDecision, smallest_listed
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.findings import findings
from photocal.accuracy.value_class import ValueClass, class_cm
from photocal.findings.catalogue import Catalogue, catalogue
from photocal.findings.texts import finding_json

SCHEMA = "photocal.check/2"


def to_json(assessment: Assessment, say: Catalogue | None = None) -> dict[str, Any]:
    """Give an assessment as a JSON value: lengths in m; null where a figure does not exist."""
    question = assessment.question
    space = assessment.space
    similarity = assessment.similarity
    return {
        "schema": SCHEMA,
        "sign": SIGN,
        "unit": "m",
        "points": len(assessment.discrepancies.points),
        "question": {
            "scale_denominator": question.scale_denominator,
            "interval_m": question.interval_m,
            "confidence": question.confidence,
            "survey_horizontal_m": question.survey_horizontal_m,
            "survey_vertical_m": question.survey_vertical_m,
        },
        "components": {component.name: _component(component) for component in assessment.components},
        "planimetry": _vector(assessment.plane, "ce90"),
        "height": _vector(assessment.height, "le90"),
        "space": _vector(space, None),
        "similarity_trend": None
        if similarity is None
        else {
            "shift_m": list(similarity.shift_m),
            "scale": similarity.scale,
            "rotation_mrad": similarity.rotation_rad * 1e3,
            "rmse_left_m": similarity.rmse_left_m,
        },
        "standards": [_table(table) for table in assessment.tables]
        + [_value(value) for value in assessment.values],
        "findings": [finding_json(one, say or catalogue("en")) for one in findings(assessment)],
    }


def _component(component: ComponentResult) -> dict[str, Any]:
    figures, bias, normality = component.moments, component.bias, component.normality
    return {
        "n": figures.n,
        "mean_m": figures.mean_m,
        "correction_m": -figures.mean_m,
        "std_m": finite(figures.std_m),
        "rmse_m": figures.rmse_m,
        "rmse_after_trend_removal_m": component.rmse_after_trend_removal_m,
        "minimum_m": component.spread.minimum_m,
        "maximum_m": component.spread.maximum_m,
        "median_m": component.spread.median_m,
        "nmad_m": component.spread.nmad_m,
        "bias_test": None
        if bias is None
        else {
            "t": finite(bias.t),
            "critical": bias.critical,
            "confidence": bias.confidence,
            "p_value": bias.p_value,
            "biased": bias.significant,
        },
        "normality_test": None
        if normality is None
        else {"w": normality.w, "p_value": normality.p_value, "rejected": normality.rejected},
        "outliers": list(component.outliers),
    }


def _vector(result: VectorResult | None, name: str | None) -> dict[str, Any] | None:
    if result is None:
        return None
    statistics = result.statistics
    figures: dict[str, Any] = {
        "n": statistics.n,
        "rmse_m": statistics.rms_m,
        "mean_length_m": statistics.mean_m,
        "maximum_m": statistics.maximum_m,
        "counted_90_m": result.counted_m,
    }
    if name is not None:
        figures[f"{name}_m"] = result.probable_m
    return figures


def _table(result: TableResult) -> dict[str, Any]:
    table = result.table
    return {
        "standard": result.standard_id,
        "product": table.product,
        "basis": table.basis,
        "size": result.size,
        "precision_class": result.precision_class,
        "accuracy_class": result.accuracy_class,
        "differ": result.differ,
        "classes": [_decision(decision) for decision in result.decisions],
        "smallest": [_admitted(admitted, table.sizes()) for admitted in result.admitted],
        "source": table.source,
        "second_hand": table.second_hand,
        "source_note": table.source_note,
    }


def _decision(decision: ClassDecision) -> dict[str, Any]:
    return {
        "class": decision.limit.name,
        "pec_m": decision.limit.pec_m,
        "ep_m": decision.limit.ep_m,
        "chi_squared": [test.chi_squared for test in decision.precision],
        "chi_squared_limit": decision.precision[0].critical if decision.precision else None,
        "precision": decision.precise,
        "rmse_within_ep": decision.rmse_within,
        "share_within_pec": decision.share_within,
        "share_enough": decision.share_passes,
        "accuracy": decision.accurate,
    }


def _admitted(admitted: AdmittedSize, sizes: tuple[float, ...]) -> dict[str, Any]:
    return {
        "class": admitted.name,
        "precision": admitted.precision,
        "rmse": admitted.rmse,
        "share": admitted.share,
        "accuracy": admitted.accuracy,
        "next_listed": smallest_listed(sizes, admitted.accuracy),
    }


def _value(value: ValueClass) -> dict[str, Any]:
    def rmse(figure: float | None) -> dict[str, float] | None:
        return None if figure is None else {"rmse_m": figure, "class_cm": class_cm(figure)}

    return {
        "standard": value.standard.id,
        "horizontal": rmse(value.horizontal_m),
        "vertical": rmse(value.vertical_m),
        "vegetated": rmse(value.vegetated_m),
        "space": rmse(value.spatial_m),
        "survey_included": {
            "horizontal": value.survey_included_horizontal,
            "vertical": value.survey_included_vertical,
        },
        "enough_points": value.enough_points,
        "required_points": int(value.standard.minimum_points.value),
    }


def finite(value: float) -> float | None:
    """Give a number that JSON knows, or None."""
    return value if math.isfinite(value) else None
