"""Face metrics of `evaluate` on an artificial workspace, their page, and options of the table of faces."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from toy_workspace import FPS, FRAMES, toy_workspace

from pipelines import evaluate
from pipelines.evaluate_face import measure_faces, stack_faces
from pipelines.results.face_rows import FaceRow, measure, measured_row, read_rows, write_row
from pipelines.results.face_table import document, options, summarise, syllable_times_s
from pipelines.results.table_runs import METRICS_FILE, SEEDS, RowResult
from talkingeyes.audio.annotation import Annotation, Phoneme
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.corpus.samples import FaceSamples
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.papers.probtalk3d_metrics import paired_differences, summarise_face, summarise_seeds
from talkingeyes.evaluation.papers.probtalk3d_surface import FaceSurface
from talkingeyes.evaluation.papers.probtalk3d_table import LABEL_PX, face_markdown, frame_sheet, heat_colours, heat_map
from talkingeyes.head.anny import anny_head
from talkingeyes.orchestration.stage_graph import StageCall

SHAPES = ("browInnerUp", "mouthFunnel")


def faced(motion, rng):
    """A motion with a moving face."""
    return replace(
        motion,
        jaw=np.stack([rng.uniform(0, 0.2, FRAMES), *np.zeros((2, FRAMES))], axis=1),
        expression=rng.uniform(0, 1, (FRAMES, len(SHAPES))),
        expression_names=SHAPES,
    )


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    """Truth and fitted motion have faces; model `copy` returns those of the truth, `noise` others."""
    made, rng = toy_workspace(tmp_path_factory.mktemp("workspace")), np.random.default_rng(0)
    corpus = Corpus(made.corpus)
    for clip in corpus.clips:
        truth = faced(corpus.truth(clip), rng)
        truth.save(shard_path(corpus.root / "truth", clip.id, ".npz"))
        fitted = shard_path(made.data("fit", "motion"), clip.id, ".npz")
        replace(Motion.load(fitted), jaw=truth.jaw, expression=truth.expression, expression_names=SHAPES).save(fitted)
        if clip.split in ("test", "unseen") and clip.take == 0:
            again = [faced(truth, rng) for _ in range(4)]
            for name, drawn in (("copy", [truth] * 4), ("noise", again)):
                stack_faces(drawn).save(make_shard_path(made.data("sample", name), clip.id, ".npz"))
    return made


@pytest.fixture(scope="module")
def tables(workspace):
    for row in ("copy", "noise"):
        evaluate.run(workspace, row)
    return {
        name: json.loads(workspace.data("evaluate", name, "metrics.json").read_text()) for name in ("copy", "noise")
    }


def test_face_model_has_only_the_face(workspace, tables):
    for table in tables.values():
        assert {split: set(parts) for split, parts in table.items()} == {"test": {"face"}, "unseen": {"face"}}
    copied, noise = tables["copy"]["test"]["face"], tables["noise"]["test"]["face"]
    for name in ("mve", "lve", "mee", "ce_squared", "fdd_absolute", "diversity"):
        assert copied[name]["value"] == 0.0 < noise[name]["value"], name
    assert noise["ce"]["value"] < noise["lve"]["value"]
    assert noise["mve"]["low"] <= noise["mve"]["value"] <= noise["mve"]["high"]
    assert "emotion_accuracy" not in noise, "nobody says what the toys feel"
    assert workspace.data("evaluate", "copy", "benchmark.json").is_file()


def test_true_takes_are_compared_with_each_other(workspace):
    corpus = Corpus(workspace.corpus)
    sources = workspace.input_paths("truth")
    takes = [clip for clip in corpus.clips if clip.sound == "e0"]
    assert len(takes) == 3
    several, alone = measure_faces(sources, [takes, takes[:1]], jobs=1, seed=0)
    assert several.errors is not None
    assert several.errors.lve > 0
    assert several.diversity == several.diversity_truth > 0
    assert alone.errors is None
    again = measure_faces(sources, [takes], jobs=1, seed=0)
    assert again[0].errors == several.errors


def test_seeds_are_averaged_with_their_range(workspace):
    corpus = Corpus(workspace.corpus)
    sounds = [[clip] for clip in corpus.select("test", "unseen", take=0)]
    by_seed = [measure_faces(workspace.input_paths(row), sounds, jobs=1, seed=0) for row in ("copy", "noise")]
    settings = BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0)
    both, noise = summarise_seeds(by_seed, settings), summarise_face(by_seed[1], settings)
    assert both["lve"].value == pytest.approx(noise["lve"].value / 2)
    assert (both["lve"].seed_min, both["lve"].seed_max) == (0.0, noise["lve"].value)
    assert both["lve"].low == pytest.approx(noise["lve"].low / 2)
    itself = paired_differences(by_seed, by_seed, settings)["lve"]
    assert (itself.low, itself.high) == (0.0, 0.0), "paired: the spread over sounds cancels"
    apart = paired_differences(by_seed[1:], by_seed[:1], settings)["lve"]
    assert apart.value == pytest.approx(noise["lve"].value)


def test_the_page_has_the_rows_in_order_beside_the_papers_numbers(tables):
    figure = {"value": 1.0, "low": 0.5, "high": 2.0, "seed_min": 0.75, "seed_max": 1.25}
    rows = {"probtalk3d": {"test": {"face": {"mve": figure}}}, "truth": {"test": {"face": {}}}, "mean": {"test": {}}}
    page = face_markdown(rows)
    assert page.index("| Truth (other takes) |") < page.index(
        "| ProbTalk3D | 1.000 <sub>0.500–2.000; seeds 0.750–1.250"
    )
    assert "0.7243, 60.4, 4.15, 55.49, 52.27, 0.3274" in page
    assert "Unseen" not in page
    assert "mean" not in page


def test_heat_map_is_displacement_between_frames():
    surface, frames = FaceSurface(anny_head()), 200
    expression = np.zeros((1, frames, 1))
    expression[0, ::2] = 0.5  # back and forth, by the same amount each time
    steady = heat_map(surface, FaceSamples(FPS, np.zeros((1, frames, 3)), expression, ("mouthFunnel",), "anny"))
    shape = surface.model.expression[surface.model.shape("mouthFunnel")][surface.regions["face"]]
    assert np.allclose(steady.mean_mm, 500 * np.linalg.norm(shape, axis=1), atol=1e-3)
    assert steady.sd_mm.max() < 0.01
    colours = heat_colours(surface.model, np.ones(len(surface.model.template)))
    eyes = surface.model.vertices_of("pupil")
    assert np.array_equal(colours[eyes], surface.model.colours[eyes])
    assert not np.allclose(colours[surface.regions["lips"]], surface.model.colours[surface.regions["lips"]])


def test_sheet_of_frames_at_syllables():
    annotation = Annotation(phonemes=(Phoneme(0.0, 0.2, "a"), Phoneme(0.2, 0.3, "p"), Phoneme(0.4, 0.6, "p")))
    times_s = syllable_times_s(annotation)
    assert times_s == {"p": pytest.approx(0.25), "a": pytest.approx(0.1)}
    jaw = np.zeros((1, 10, 3))
    jaw[0, 2, 0] = 0.4  # at 0.1 s
    opening = FaceSamples(25.0, jaw, np.zeros((1, 10, 1)), ("mouthFunnel",), "anny")
    closed = FaceSamples(25.0, 0 * jaw, np.zeros((1, 10, 1)), ("mouthFunnel",), "anny")
    sheet = frame_sheet(anny_head(), {"opening": opening, "closed": closed}, times_s, 48)
    assert sheet.shape == (2 * (48 + LABEL_PX) + LABEL_PX, 96, 3)
    first, second = sheet[2 * LABEL_PX : 2 * LABEL_PX + 48], sheet[-48:]
    assert np.array_equal(first[:, :48], second[:, :48]), "p: both are closed"
    assert not np.array_equal(first[:, 48:], second[:, 48:]), "a: one is open"


def test_rows_of_several_runs_make_one_page(workspace, tmp_path):
    """A file of a row with a seed each; a row that is missing, or has fewer seeds, is named."""
    measure(StageCall("face_metrics", "noise", (), (), ()), workspace)
    stored = RowResult("noise", workspace.data("face_metrics", "noise", METRICS_FILE))
    by_split = measured_row(stored, 0, "c0").sounds
    learnt = {"500": 4.0, "1000": 3.5}, 0.25
    for name, seed in (("probtalk3d", 0), ("probtalk3d", 1), ("face_vae", 1), ("truth", 0)):
        given = ({}, None) if name == "truth" else learnt
        write_row(tmp_path, FaceRow(name, seed, "c0", "r0", *given, by_split))
    rows = read_rows(tmp_path)
    assert {name: [each.seed for each in seeds] for name, seeds in rows.items()} == {
        "probtalk3d": [0, 1],
        "face_vae": [1],
        "truth": [0],
    }
    read = rows["face_vae"][0].sounds["unseen"][0]
    assert read.errors is not None
    assert read.errors.lve == pytest.approx(by_split["unseen"][0].errors.lve, rel=1e-4)
    table = summarise(rows, BootstrapSettings(n_resamples=50, confidence_level=0.95, seed=0))
    for name in ("face_vae", "truth"):
        assert table[name]["unseen"]["minus_probtalk3d"]["lve"]["value"] == 0.0, "the same sounds"
    text = document(table, rows)
    assert "Means over the seeds 0, 1," in text
    assert "Not computed yet: Fitted motion (training target); Mean face;" in text
    assert "With fewer seeds: VAE." in text
    assert "| VAE | 4.00 | **3.50** | 0.25 |" in text
    with pytest.raises(InputError, match=r"probtalk3d-0.json: should have configuration c1, got c0; remove the file"):
        read_rows(tmp_path, {"probtalk3d": "c1"})
    (tmp_path / "other.json").write_text("[]")
    with pytest.raises(
        InputError, match=r"other.json: should be a result of pipelines.results.face_table, got TypeError"
    ):
        read_rows(tmp_path)


def test_table_options_are_seeds_and_folder(tmp_path):
    wanted = options(["--out", str(tmp_path), "seeds=4,5", "train.seed=9"])
    assert (wanted.out, wanted.seeds) == (tmp_path, [4, 5])
    assert wanted.overrides == ["experiment=probtalk3d_table", "train.seed=9"]
    plain = options(["experiment=tiny"])
    assert (plain.seeds, plain.overrides) == (list(SEEDS), ["experiment=tiny"])
    with pytest.raises(InputError, match=r"^seeds: should be numbers such as seeds=0,1,2, got 'x'$"):
        options(["seeds=x"])
    with pytest.raises(InputError, match=r"^--out: should name a folder, got none$"):
        options(["--out"])
