"""Both papers' claims, each compared with a run of papers.py: reproduced, surpassed, or not reached and by how much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from _papers_results import Results, in_order, median

REPRODUCED, SURPASSED, NOT_REACHED, UNKNOWN = "reproduced", "surpassed", "not reached", "not measured"
IN_PICTURES = "pictures, no number"
PAPER_SECONDS = {"intel": (1311, 133.7, 13.4), "fr079": (833, 118.4, 29.5), "killian": (5489, 56.0, 42.0)}
"""MC Table I: N, R and seconds of the logs that we have too, with other numbers of scans."""

SPECIFICITIES = (1.0, 0.95, 0.9, 0.8, 0.5)
FEWEST_SEEDS = 10
NEAR = 0.9
"""Specificity and recall of at least this are called near (1, 1)."""

PAPER_THREADS, OUR_THREADS = 8, 2


@dataclass(frozen=True)
class Claim:
    """``verdict`` is one of the four words above, with the gap where a claim is not reached."""

    source: str
    text: str
    theirs: str
    ours: str
    verdict: str


def claims(results: Results) -> list[Claim]:
    """All claims in the papers' order."""
    found = [
        *_experiment(results, "slip", "IGO V-A, Fig. 5, 6", "wheels slip", count=30),
        *_experiment(results, "corridor", "IGO V-B, Fig. 6, 7", "laser alone", drive="laser alone"),
        _unbiased(results),
        *_power(results),
        _dynamics(results),
        *_tuning(results),
        *_seconds(results),
    ]
    return found


def _experiment(results: Results, name: str, source: str, what: str, **wanted: Any) -> list[Claim]:
    """GMapping worse than GO, GO worse than iGO: by medians over the seeds."""
    errors = {method: results.errors(name, method, **wanted) for method in ("gmapping", "go", "igo")}
    found = []
    for worse, better in (("gmapping", "go"), ("go", "igo")):
        text = f"{what}: {better} is more accurate than {worse}"
        if not errors[worse] or not errors[better]:
            found.append(Claim(source, text, IN_PICTURES, "-", UNKNOWN))
            continue
        high, low = median(errors[worse]), median(errors[better])
        count, total = in_order(errors[worse], errors[better])
        ours = f"median {high:.4f} m, {low:.4f} m; in {count} of {total} seeds"
        holds = high > low and 2 * count > total
        gap = "" if holds else f": {better} / {worse} = {low / high:.2f}"
        gap += f" (by {total} seeds only)" if total < FEWEST_SEEDS else ""
        found.append(Claim(source, text, IN_PICTURES, ours, (REPRODUCED if holds else NOT_REACHED) + gap))
    return found


def _unbiased(results: Results) -> Claim:
    """Where no edge is biased, iGO keeps what GO found."""
    text = "well estimated edges are kept: without slips igo is as good as go"
    parts, good = [], []
    for log in ("intel", "fr079"):
        rows = {row["method"]: row for row in results.compared(log) if "translation_mean_m" in row}
        if "go" in rows and "igo" in rows:
            go, igo = (rows[method]["translation_mean_m"] for method in ("go", "igo"))
            parts.append(f"{log} go {go:.4f} m, igo {igo:.4f} m")
            good.append(igo <= 1.05 * go)
    verdict = UNKNOWN if not parts else REPRODUCED if all(good) else NOT_REACHED
    return Claim("IGO IV-B", text, "no number", "; ".join(parts) or "-", verdict)


def _power(results: Results) -> list[Claim]:
    """MC Figure 3: recall and specificity, and Haehnel's test beside it."""
    tables = {row["maps"]: row for row in _curves(results)}
    near, beside = "near (1, 1)", "above it everywhere"
    found = []
    for kind, figure in (("static", "3a"), ("dynamic", "3b"), ("all", "3c")):
        source, row = f"MC VI-A, Fig. {figure}", tables.get(kind)
        texts = (f"{kind} maps: specificity and recall", f"{kind} maps: recall above that of Haehnel's test")
        if row is None:
            found += [
                Claim(source, text, paper, "-", UNKNOWN) for text, paper in zip(texts, (near, beside), strict=True)
            ]
            continue
        specificity, recall = float(row["specificity"]), float(row["recall"])
        missed = "" if min(recall, specificity) >= NEAR else f": {min(recall, specificity):.2f}"
        verdict = NOT_REACHED + missed if missed else REPRODUCED
        found.append(Claim(source, texts[0], near, f"specificity {specificity:.2f}, recall {recall:.2f}", verdict))
        found.append(_beside_haehnel(source, texts[1], beside, row))
    return found


def _beside_haehnel(source: str, text: str, theirs: str, row: dict[str, str]) -> Claim:
    """By recall at five specificities."""
    mine, rivals = _recalls(row, "curve"), _recalls(row, "Haehnel")
    pairs = list(zip(SPECIFICITIES, mine, rivals, strict=True))
    lower = [f"{at:g} {rival:.2f} to {recall:.2f}" for at, recall, rival in pairs if recall < rival]
    ours = f"at specificity 1 {mine[0]:.2f} to {rivals[0]:.2f}, at 0.9 {mine[2]:.2f} to {rivals[2]:.2f}"
    verdict = f"{NOT_REACHED}: Haehnel's is higher at specificity {', '.join(lower)}" if lower else REPRODUCED
    return Claim(source, text, theirs, ours, verdict)


def _curves(results: Results) -> list[dict[str, str]]:
    """The rows of the table with specificity and recall: the second that the step prints."""
    blocks = results.printed("power").split("\n\n")
    for block in blocks:
        lines = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in block.splitlines() if "|" in line]
        if lines and "specificity" in lines[0]:
            return [dict(zip(lines[0], line, strict=False)) for line in lines[2:]]
    return []


def _recalls(row: dict[str, str], column: str) -> list[float]:
    text = next((value for key, value in row.items() if key.startswith(column)), "0")
    return [float(word) for word in text.split(",")]


def _dynamics(results: Results) -> Claim:
    """MC Figure 5: Killian Court, with people walking: two scans inconsistent."""
    text = "Killian Court: people walking do not make scans inconsistent, objects that were moved do"
    answer = results.answer("check-killian")
    theirs = "2 of 5,489 scans"
    if not answer:
        return Claim("MC VI-A, Fig. 5", text, theirs, "-", UNKNOWN)
    failed, scans = answer["scans_inconsistent"], answer["scans"]
    ours = f"{failed} of {scans:,} scans, on another graph of that log, whose map shows one corridor twice"
    reached = failed / scans <= 0.01
    verdict = REPRODUCED if reached else f"{NOT_REACHED}: {100 * failed / scans:.1f} % of the scans"
    return Claim("MC VI-A, Fig. 5", text, theirs, ours, verdict)


def _tuning(results: Results) -> list[Claim]:
    """MC Figure 4: with phi = 1 one of five maps is consistent, with phi* four; Bicocca's never is."""
    source = "MC VI-B, Fig. 4"
    texts = ("the parameter found, phi*, gives a consistent map", "the suggested phi = 1 does not")
    theirs = ("4 of 5 maps consistent", "1 of 5 maps consistent")
    rows = [row for row in results.lines("tuning") if row["what"] == "errors" and row["case"]["count"]]
    if not rows:
        return [Claim(source, text, paper, "-", UNKNOWN) for text, paper in zip(texts, theirs, strict=True)]
    found, default = (sum(bool(row[key]) for row in rows) for key in ("consistent", "consistent_1"))
    share = found / len(rows)
    first = REPRODUCED if share >= 0.8 else f"{NOT_REACHED}: {100 * share:.0f} %"
    fails = default < found
    second = REPRODUCED if fails else f"{NOT_REACHED}: on these graphs phi = 1 does as well"
    errors = [median(dict(enumerate(row["errors"][key][0] for row in rows))) for key in ("phi*", "phi = 1", "clean")]
    off = f"median error {errors[0]:.4f} m, with phi = 1 {errors[1]:.4f} m, without false loops {errors[2]:.4f} m"
    ours = (f"{found} of {len(rows)}; {off}", f"{default} of {len(rows)}")
    return [
        Claim(source, text, paper, mine, verdict)
        for text, paper, mine, verdict in zip(texts, theirs, ours, (first, second), strict=True)
    ]


def _seconds(results: Results) -> list[Claim]:
    """MC Table I by the pair: their graphs have other numbers of scans."""
    found = []
    rows = {row["graph"].split(".")[0]: row for row in results.table("table1")}
    for name, (scans, others, seconds) in PAPER_SECONDS.items():
        each_us = 1e6 * seconds / (0.5 * scans * others)
        theirs = f"{seconds} s, {each_us:.0f} us a pair on {PAPER_THREADS} threads"
        text = f"runtime of the test on {name}"
        if name not in rows:
            found.append(Claim("MC VI-C, Table I", text, theirs, "-", UNKNOWN))
            continue
        whole, pairs = float(rows[name]["check [s]"]), int(rows[name]["pairs"].replace(",", ""))
        mine_us = 1e6 * whole / pairs
        ours = f"{whole:.1f} s, {mine_us:.1f} us a pair on {OUR_THREADS} threads"
        found.append(Claim("MC VI-C, Table I", text, theirs, ours, _faster(each_us, mine_us)))
    return found


def _faster(theirs_us: float, ours_us: float) -> str:
    times = theirs_us / ours_us
    return f"{SURPASSED}: {times:.0f} times" if times > 1.0 else f"{NOT_REACHED}: {1.0 / times:.1f} times as long"
