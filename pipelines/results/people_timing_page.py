"""The section of docs/results/people.md on timing face to face, from people_timing.json.

Used by: pipelines.results.people, pipelines.results.people_timing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from talkingeyes.evaluation.people.conversations import AGREED
from talkingeyes.evaluation.people.timing import INFORMATION, timing_table
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.workflows.evaluate_timing import row_name

ROWS = ("truth", "default", "live", "aligned_replay", "pieced_replay", "random")
TEST_ROWS = ("turns", "rules", "default", "live", "random")
AGREEING = row_name(AGREED)

SECTION = """## Face to face: when gaze is averted

{table}

Rows: the people, by each of two coders and where both agree; `truth`, the synthetic data; `default` and `live`, the
packaged models alone; `aligned_replay` and `pieced_replay`, training motion replayed where the sound is as loud
(`models/replay.py`); `random`, the true motion of a random training clip under another sound. Intervals (95 %) resample
pairs of people, and speakers of motions.

{findings}

### Direct test

Speech is laid on the turns of one person of each of {pairs} pairs, for {seconds:.0f} s. The probability that gaze is
averted is the share of {samples} samples. The figure is the log-likelihood of what the person did, less that of the
same under turns shifted by a minute, or of a constant rate, in nats per second
([log](../log/2026-11-29-timing-on-people.md)).

{test}

`turns`: what the turns themselves say about aversion of these people in this time, estimated from the other pairs.
`rules`: the rules that made the truth. `random`: the rules under the turns of another pair.

### Face to face: input

- `CONTACT`: looks at the partner, a CSV table with the columns pair, person (a or b), coder, start_ms, end_ms. All
  other time up to the coder's last look counts as averted. One coder is enough.
- `TURNS`: who speaks, a CSV table with the columns pair, start_s, end_s, speaker (a or b), in order of time.
- `--reference`: a corpus with turns of the partner. Or `--sound`: a folder of sounds with two channels, first the
  subject's, then the partner's; who has the turn is detected by level.

The people of this page: Wohltjen & Wheatley 2021, *Eye contact marks the rise and fall of shared attention in
conversation* (PNAS 118(37)), doi 10.1073/pnas.2106645118, <https://github.com/sophiewohltjen/eyeContact-in-conversation>.
24 pairs talk face to face for ten minutes. No licence is stated, so this project has figures of them alone.

### Face to face: method

- Turns of all rows are rounded to the second, as those of the recordings are. Turns without length vanish.
- Averted, of people: no look at the partner; of motions: gaze in space more than 4 degrees from its densest place
  ([detectors.md](../detectors.md)).
- Durations are Kaplan-Meier medians. Rise: share averted from -0.3 to 0.7 s around a start less that from -2 to -1.4 s.
  Fall: that from -2 to -1.4 s around an end less that from 0.4 to 1.4 s after it. Both between turns of 2 s or more.
- Information of turns: how much more likely the state is (averted or not) given the time to the nearest start or end of
  an own turn than given the turns of a minute before, estimated from the other pairs or speakers
  (`evaluation/people/timing.py`).

### Face to face: limits

- The coders agree moderately. A start or an end is known to the second alone, which flattens rise and fall in all rows.
- People look away to think and to show it; the models know speech alone.
- The models are alone, without the rules of `animate` (with `--partner`, one of them sets gaze while listening).
- The direct test is small: no gain over shifted turns is above 0 with certainty, so it does not tell the rows apart.
- The intervals of the information are wide: people differ in how much they look away, and 24 pairs are few."""


def section(content: Mapping[str, Any]) -> str:
    """The section, as Markdown."""
    return SECTION.format(
        table=_table(content),
        findings="\n".join(findings(content)),
        test=_likelihood_table(content["likelihood"]),
        **content["direct_test"],
    )


def _table(content: Mapping[str, Any]) -> str:
    people = [name for name in content["rows"] if name.startswith("people")]
    rows = {name: content["rows"][name] for name in (*people, *ROWS) if name in content["rows"]}
    heading, *lines = timing_table({**content, "rows": rows})
    return markdown_table(heading, lines)


def _likelihood_table(by_coder: Mapping[str, Any]) -> str:
    heading = ["", *(f"{row_name(name)}: over {what}" for name in by_coder for what in ("shifted", "constant"))]
    lines = []
    for row in TEST_ROWS:
        cells = [each[row].get(name) for each in by_coder.values() for name in ("shifted", "constant")]
        lines.append(
            [row, *("-" if each is None else "{value:.4f} ({low:.4f} to {high:.4f})".format(**each) for each in cells)]
        )
    return markdown_table(heading, lines)


def findings(content: Mapping[str, Any]) -> list[str]:
    """Which rows have the people's timing, as lines of a list: intervals that overlap where the coders agree."""
    rows = {name: content["rows"][name]["measures"] for name in (AGREEING, *ROWS) if name in content["rows"]}
    lines = []
    for measure in ("start_rise", "end_fall", INFORMATION):
        title, people = content["measures"][measure]["title"], rows[AGREEING][measure]
        ours = {name: found[measure] for name, found in rows.items() if name != AGREEING and measure in found}
        within = [
            name for name, found in ours.items() if found["low"] <= people["high"] and people["low"] <= found["high"]
        ]
        above = [name for name, found in ours.items() if found["low"] > 0]
        lines.append(
            f"- {title[0].upper()}{title[1:]}: above 0 for {_listed(above)}; intervals that overlap the people's:"
            f" {_listed(within)}."
        )
    return lines


def _listed(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) if names else "none"
