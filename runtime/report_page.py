"""A report as one HTML page: readable on a phone, printed or offline; no script, no other file."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from runtime.charts import Axis, Reference, Series, legend, scatter
from runtime.picture import colour_map
from runtime.report_style import STYLE

__all__ = ["page"]

Report = Mapping[str, Any]

SEARCH = (
    "Searched models are the smallest that are expected to err so much, as prtnet train "
    "--max-error finds them, among kinds that fit in seconds; the first has the seconds of fitting "
    "all that they are chosen from. "
)
DISTANCES = ("outside the range, half diagonals", "to the nearest pose, spacings")
NO_DISTANCE = 1e-3  # what training poses themselves have, by rounding


def page(report: Report, images: Sequence[tuple[str, str, str]] = ()) -> str:
    """The whole page.

    Args:
        report: of ``prtnet.report.assemble``, with ``pictures``: for each pose that is drawn its
            ``title``, ``pose`` (position in ``poses``) and ``top`` (per cent).
        images: for each of them prediction, truth and error as ``data:`` addresses.
    """
    name = report["dataset"]["name"]
    sections = [
        summary(report),
        cost_section(report),
        model_section(report),
        picture_section(report, images),
        worst_section(report),
        distance_section(report),
        clip_section(report),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(name)}: soft shadows</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
        f"<main>\n<h1>{escape(name)}: what soft shadows cost, and what they miss</h1>\n"
        + "\n".join(part for part in sections if part)
        + "\n</main>\n</body>\n</html>\n"
    )


def escape(text: object) -> str:
    """Text that is no markup."""
    return html.escape(str(text), quote=True)


def per_cent(value: float | None) -> str:
    """A fraction as per cent."""
    return "–" if value is None else f"{100 * value:.2f} %"


def megabytes(count: float) -> str:
    """Bytes as MB, with three digits that count."""
    size = count / 1e6
    return f"{size:.0f} MB" if size >= 100 else f"{size:.1f} MB" if size >= 10 else f"{size:.2f} MB"


def milliseconds(value: float) -> str:
    """A time of one pose."""
    return f"{value:.2f} ms" if value >= 0.1 else f"{value:.3f} ms"


def duration(value: float) -> str:
    """A time of a fit."""
    return f"{value:.0f} s" if value >= 100 else f"{value:.2g} s"


def seconds(value: float | None) -> str:
    """A time in a clip."""
    return "–" if value is None else f"{value:.2f} s"


def number(value: float | None) -> str:
    """A ratio."""
    return "–" if value is None else f"{value:.3f}"


def count(value: int) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{value:,}".replace(",", "\u202f")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], marked: int | None = None) -> str:
    """A table that scrolls by itself where it is too wide; the row ``marked`` stands out."""
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in columns)
    body = "\n".join(
        f"<tr{' class=best' if index == marked else ''}>"
        + f'<th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for index, row in enumerate(rows)
    )
    return (
        f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n'
        "</tbody></table></div>"
    )


def best_of(report: Report) -> Mapping[str, Any]:
    """The most accurate model."""
    return next(model for model in report["models"] if model["name"] == report["best"])


def section(title: str, *parts: str) -> str:
    """A section; empty parts are left out."""
    body = "\n".join(part for part in parts if part)
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>"


def paragraph(text: str, kind: str = "") -> str:
    """Text that is no markup."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>"


def judged(report: Report) -> str:
    """What the errors are of, in a word."""
    return "held-out" if report["dataset"]["held_out"] else "training"


def summary(report: Report) -> str:
    """What matters most, in sentences, and what the dataset is."""
    facts, best, base = report["dataset"], best_of(report), report["baselines"]
    clips = ", ".join(facts["clips"])
    note = (
        f"Errors are of {count(facts['judged_poses'])} poses that no fit has seen, of {clips}."
        if facts["held_out"]
        else "This dataset holds out no clip, so errors are of the poses that training saw and say "
        "nothing about unseen motion. Generate it with --holdout to learn that."
    )
    return "\n".join(
        [
            paragraph(
                f"The most accurate model here ({best['name']}) errs by {per_cent(best['rms'])}, "
                f"takes {milliseconds(best['ms_per_pose'])} a pose and "
                f"{megabytes(best['model_bytes'])}. Predicting the mean whatever the pose errs "
                f"by {per_cent(base['mean']['rms'])}; answering with the nearest training pose "
                f"errs by {per_cent(base['nearest']['rms'])} and keeps "
                f"{megabytes(base['nearest']['bytes'])}.",
                "lead",
            ),
            paragraph(note, "note"),
            paragraph(
                "Errors are relative RMS of visibility, √(Σ‖ṽ − v‖² / Σ‖v‖²) over poses and "
                f"vertices, against {count(facts['rays'])} rays a vertex. Times are of one pose in "
                "onnxruntime on this machine's processor; MB are 10⁶ bytes."
            ),
            table(
                ["scene", "vertices", "receivers", "triangles", "training poses", "judged poses",
                 "order", "rays", "dataset"],
                [[facts["name"], count(facts["vertices"]), count(facts["receivers"]),
                  count(facts["faces"]), count(facts["training_poses"]),
                  count(facts["judged_poses"]), str(facts["order"]), count(facts["rays"]),
                  megabytes(facts["visibility_bytes"])]],
            ),
            paragraph(
                "Receivers are where visibility is traced and predicted: every vertex once, or "
                "twice where both sides of the surface count. It is stored as order² numbers a "
                "receiver, spherical harmonics; rays are those traced for each. The dataset is "
                "what all of that takes, raw, for every pose."
            ),
        ]
    )  # fmt: skip


def cost_section(report: Report) -> str:
    """Error against time and against size."""
    models, base = report["models"], report["baselines"]
    families = list(dict.fromkeys(model["family"] for model in models))
    references = [Reference(f"mean {per_cent(base['mean']['rms'])}", 100 * base["mean"]["rms"])]
    if base["nearest"]["rms"] is not None:
        near = base["nearest"]["rms"]
        references.append(Reference(f"nearest pose {per_cent(near)}", 100 * near))
    errors = [100 * m["rms"] for m in models] + [line.y for line in references]
    y = Axis.around(f"{judged(report)} error, %", errors)

    def chart(cost: str, unit: float, front: str, title: str, extra: list[Series]) -> str:
        series = [family_series(models, family, cost, unit) for family in families] + extra
        x = Axis.around(title, [p[0] for each in series for p in each.points], log=True)
        best = [(m[cost] * unit, 100 * m["rms"]) for m in models if m[front]]
        words = f"{judged(report)} error against {title}"
        return f"<figure>{scatter(series, x, y, words, references, best)}</figure>"

    stored = [
        Series("nearest pose (keeps the training data)", nearest_point(base), ["nearest pose"]),
        Series("raw data: every pose stored, no error",
               [(base["raw"]["bytes"] / 1e6, 0.0)],
               [f"raw data: {megabytes(base['raw']['bytes'])}"]),
    ]  # fmt: skip
    stored = [each for each in stored if each.points]
    charts = [
        chart("ms_per_pose", 1.0, "on_time_front", "milliseconds a pose", []),
        chart("model_bytes", 1e-6, "on_size_front", "megabytes", stored),
    ]
    return section(
        "Error against cost",
        paragraph(
            "Down and to the left is better. A point is a model, a line joins the sizes of one "
            "family; the grey steps join the models that no other beats in both error and cost: "
            "choose one of those. Dashed lines are what knowing no model gives. The chart of "
            "megabytes also has the data themselves, which err by nothing but grow with every pose."
        ),
        f'<div class="pair">{"".join(charts)}</div>',
        legend([*families, *(each.name for each in stored)]),
    )


def nearest_point(base: Mapping[str, Any]) -> list[tuple[float, float]]:
    """The nearest pose's megabytes and error in per cent; none where it is not known."""
    near = base["nearest"]
    return [] if near["rms"] is None else [(near["bytes"] / 1e6, 100 * near["rms"])]


def family_series(
    models: Sequence[Mapping[str, Any]], family: str, cost: str, unit: float
) -> Series:
    """The models of a family by cost."""
    own = sorted((m for m in models if m["family"] == family), key=lambda m: float(m[cost]))
    labels = [
        f"{m['name']}: {per_cent(m['rms'])}, {milliseconds(m['ms_per_pose'])}, "
        f"{megabytes(m['model_bytes'])}"
        for m in own
    ]
    return Series(family, [(m[cost] * unit, 100 * m["rms"]) for m in own], labels, joined=True)


def model_section(report: Report) -> str:
    """Every model in figures."""
    models = report["models"]
    unseen = report["dataset"]["held_out"]  # otherwise the errors are of training anyway
    rows = [
        [m["name"], per_cent(m["rms"]), per_cent(m["p99"]),
         *([per_cent(m["training_rms"])] if unseen else []),
         per_cent(m["pca_floor"]), per_cent(m["variance_kept"]), f"{m['inputs']}",
         f"{m['latents']:.1f}", megabytes(m["model_bytes"]), milliseconds(m["ms_per_pose"]),
         duration(m["fit_seconds"]), duration(m["train_seconds"]), number(m["coherence"])]
        for m in models
    ]  # fmt: skip
    columns = [
        "model", f"{judged(report)} error", "99 % of vertices below",
        *(["training error"] if unseen else []), "floor", "variance kept", "inputs", "latents",
        "size", "one pose", "fit", "training in all", "coherence",
    ]  # fmt: skip
    marked = [m["name"] for m in models].index(report["best"])
    return section(
        "Every model",
        paragraph(
            "The error is of all poses and vertices together; next to it what 99 of 100 vertices "
            "stay below, each over all poses"
            + (", and the error on poses that the fit saw" if unseen else "")
            + ". The floor is the error that would be left if the regressor were perfect: what the "
            "kept components cannot express; variance kept says the same as a share of the "
            "deviation from the mean. Inputs and latents are numbers a cluster. Fit is the final "
            "fit alone; training in all has clusters and components besides, and for the first of "
            "a family the choice of weight decay by cross-validation, which the others take over; "
            "models in fewer bits are those above, rounded, with their seconds. "
            + (SEARCH if any(m["family"] == "searched" for m in models) else "")
            + "Coherence is how much the error moves from pose to pose, beside the truth: a model "
            "that never changes has 1, less is steadier, more flickers. The most accurate stands "
            "out."
        ),
        table(columns, rows, marked),
    )


def picture_section(report: Report, images: Sequence[tuple[str, str, str]]) -> str:
    """Prediction, truth and error of some poses."""
    if not images:
        return ""
    parts = []
    for told, uris in zip(report["pictures"], images, strict=True):
        pose = report["poses"][told["pose"]]
        parts.append(f"<h3>{escape(told['title'])}: {escape(where(pose))}</h3>")
        titles = (
            "prediction",
            "ray-traced truth",
            "error of each vertex, per cent of an open vertex",
        )
        top = float(told["top"])
        figures = "".join(
            f'<figure><img src="{uri}" alt="{escape(title)}">'
            f"<figcaption>{escape(title)}</figcaption></figure>"
            for uri, title in zip(uris, titles, strict=True)
        )
        parts.append(f'<div class="three">{figures}</div>')
        parts.append(colour_bar(top))
        parts.append(paragraph(f"This pose errs by {per_cent(pose['rms'])}."))
    return section(
        "On the character",
        paragraph(
            f"Drawn with the predictions of {report['best']}. An open vertex sees the whole sky; "
            "an error of 100 % would be all of it. Mind the scales: each pose has its own."
        ),
        *parts,
    )


def colour_bar(top: float) -> str:
    """The heat colours with their ends."""
    stops = ", ".join(
        "rgb({}, {}, {})".format(*colour.tolist()) for colour in colour_map(np.linspace(0, 1, 9))
    )
    return (
        f'<div class="bar"><span>0 %</span><span class="ramp" '
        f'style="background: linear-gradient(to right, {stops})"></span>'
        f"<span>{top:g} % and above</span></div>"
    )


def where(pose: Mapping[str, Any]) -> str:
    """A pose by clip and time."""
    return f"{pose['clip']} at {seconds(pose['time'])}"


def worst_section(report: Report) -> str:
    """The poses with the largest errors."""
    rows = [
        [pose["clip"], seconds(pose["time"]), per_cent(pose["rms"]), number(pose["distance"]),
         number(pose["nearest_distance"])]
        for pose in (report["poses"][index] for index in report["worst"])
    ]  # fmt: skip
    return section(
        "The worst poses",
        paragraph(
            f"Where {report['best']} errs most, with how far each pose is from training: outside "
            "the range of its poses, in half diagonals of that range, and from the nearest of "
            "them, in spacings, the usual distance between them. Worst poses far from training "
            "want more poses like them in the dataset; worst poses close to it want a larger model."
        ),
        table(["clip", "time in it", "error", *DISTANCES], rows),
    )


def distance_section(report: Report) -> str:
    """Error against distance from training."""
    charts = []
    for name, title in (
        ("distance", "outside the training range, half diagonals"),
        ("nearest_distance", "to the nearest training pose, spacings"),
    ):
        known = [pose for pose in report["poses"] if pose[name] is not None]
        if max((pose[name] for pose in known), default=0.0) < NO_DISTANCE:
            continue
        clips = list(dict.fromkeys(pose["clip"] for pose in report["poses"]))
        series = [
            Series(
                clip,
                [(pose[name], 100 * pose["rms"]) for pose in known if pose["clip"] == clip],
                [f"{where(pose)}: {per_cent(pose['rms'])}" for pose in known
                 if pose["clip"] == clip],
            )
            for clip in clips
        ]  # fmt: skip
        x = Axis.around(title, [pose[name] for pose in known])
        y = Axis.around("error, %", [100 * pose["rms"] for pose in known])
        words = f"error of each pose against how far it is {title}"
        charts.append(f"<figure>{scatter(series, x, y, words)}</figure>")
    if not charts:
        return ""
    return section(
        "Error against distance from training",
        paragraph(
            "A point is a pose. Outside the range: how far a pose's inputs are outside the box "
            "that the training poses span, over half the box's diagonal, averaged over clusters; "
            "0 is inside. To the nearest pose: the distance in joint angles to the nearest "
            "training pose over the usual distance between training poses; 1 is as close as they "
            "are to each other. If points climb to the right, more training poses will help."
        ),
        f'<div class="pair">{"".join(charts)}</div>',
        legend(list(dict.fromkeys(pose["clip"] for pose in report["poses"]))),
    )


def clip_section(report: Report) -> str:
    """Every clip in figures."""

    def pair(value: Mapping[str, float] | None) -> str:
        return "–" if value is None else f"{value['mean']:.3f} (max {value['max']:.3f})"

    rows = [
        [name, per_cent(clip["rms"]), per_cent(clip["p99"]), per_cent(clip["max"]),
         number(clip["coherence"]), pair(clip["distance"]), pair(clip["nearest_distance"])]
        for name, clip in report["clips"].items()
    ]  # fmt: skip
    return section(
        "Clip by clip",
        paragraph(
            f"Of {report['best']}. Coherence compares how much the error and the truth move "
            "from one pose to the next: 1 is what a shadow that never moves has, less is "
            "steadier, more flickers. The worst vertex is the one that errs most over the clip's "
            "poses. Distances, as above, are means over them."
        ),
        table(
            ["clip", "error", "99 % of vertices below", "worst vertex", "coherence", *DISTANCES],
            rows,
        ),
    )  # fmt: skip
