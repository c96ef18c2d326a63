"""`talkingeyes study`: designs, assignment of pairs, films, the page, and results for simulated participants."""

from __future__ import annotations

import itertools
import json
import math
import sqlite3
import subprocess
import sys
from collections import Counter
from pathlib import Path

import av
import numpy as np
import pytest
import yaml
from browser import CHROMIUM, open_browser
from command_line import call
from fastapi.testclient import TestClient

from talkingeyes.apps.study.answers import Answer, AnswerDatabase
from talkingeyes.apps.study.counterbalancing import ATTENTION_CHECK, Pair, assign_pairs
from talkingeyes.apps.study.design import DESIGNS_FOLDER, Design, load_design, names
from talkingeyes.apps.study.films import SOUND_DELAY_S, film_motion, static_lids
from talkingeyes.apps.study.results import preference_rates, wilcoxon_p
from talkingeyes.apps.study.server import study_app
from talkingeyes.apps.study.study_folder import Study, film_id, required_films
from talkingeyes.apps.study.tables import format_p_value, table
from talkingeyes.audio.annotation import Annotation
from talkingeyes.core.errors import InputError
from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.samples import FaceSamples, Samples
from talkingeyes.corpus.store import Corpus, make_shard_path
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.workflows import study as study_workflow
from talkingeyes.workflows.study import make_study, study_results

FPS, FRAMES = 25.0, 15

LOCAL = "http://127.0.0.1"


def pools(design: Design) -> dict[str, tuple[str, ...]]:
    clips = {s.name: tuple(f"{s.name}-{place}" for place in range(s.pool)) for s in design.strata}
    return {**clips, ATTENTION_CHECK: ("check",)}


def a_study(root: Path, design: Design, seed: int = 0) -> Study:
    """A study with placeholder files instead of films."""
    study = Study(root, design, seed, pools(design))
    (root / "films").mkdir(parents=True)
    for name in study.films:
        study.film(name).write_bytes(b"film " + name.encode())
    study.save()
    return Study.load(root)


@pytest.mark.parametrize("name", names())
def test_designs_have_the_questions_of_the_papers(name: str) -> None:
    design = load_design(name)
    shown_ = assign_pairs(design, pools(design), 0, 0)
    asked = {
        "talkingeyes_table4": (30, 6, 20),
        "probtalk3d_table2": (24, 3, 69),
        "posegan_table4": (100, 5, 50),
        "posegan_shape": (3, 1, 50),
        "eyelid_follow": (10, 1, 20),
    }[name]
    assert (len(shown_) - 1, len(design.comparisons), design.participants) == asked
    assert sum(pair.attention for pair in shown_) == 1
    if name == "posegan_table4":
        assert Counter(pair.stratum for pair in shown_ if not pair.attention) == {
            "4_seconds": 60,
            "8_seconds": 25,
            "12_seconds": 15,
        }
    if name == "probtalk3d_table2":
        assert [question.label for question in design.questions] == ["Lip Sync", "Realism", "Emotional Expression"]
        assert {count for count in Counter(pair.stratum for pair in shown_ if not pair.attention).values()} == {3}


def test_films_and_sides_are_balanced() -> None:
    design = load_design("talkingeyes_table4")
    everything = [pair for number in range(20) for pair in assign_pairs(design, pools(design), 3, number)]
    for comparison in design.comparisons:
        own = [pair for pair in everything if (pair.a, pair.b) == comparison and not pair.attention]
        assert len(own) == 100
        assert set(Counter(pair.clip for pair in own).values()) == {5}  # 20 films, 100 answers
        assert sum(pair.a_left for pair in own) == 50
    first, second = assign_pairs(design, pools(design), 3, 0), assign_pairs(design, pools(design), 3, 1)
    assert [pair.clip for pair in first] != [pair.clip for pair in second]
    assert first == assign_pairs(design, pools(design), 3, 0)
    assert first != assign_pairs(design, pools(design), 4, 0)


def chooses_a(pair: Pair, prefers: dict[tuple[str, str], float], careless: bool, rng: np.random.Generator) -> bool:
    """Answer of a simulated participant with known preferences; careless ones fail the attention check."""
    return not careless if pair.attention else bool(rng.random() < prefers[pair.a, pair.b])


def crowd(study: Study, people: int, prefers: dict[tuple[str, str], float], careless: int = 0) -> None:
    """Simulated participants who answer all questions."""
    rng = np.random.default_rng(0)
    for person in range(people):
        token = study.answers.register()
        pairs = study.pairs(person)
        for trial_index, pair in enumerate(pairs):
            who = study.answers.participant(token)
            assert who is not None
            if who.done:
                break
            chosen = {
                question.name: chooses_a(pair, prefers, person < careless, rng) for question in study.design.questions
            }
            last = trial_index + 1 == len(pairs)
            assert study.answers.add(who, pair, chosen, last, study.design.attention.ends_study)


def visit(page: TestClient, study: Study, prefers: dict[tuple[str, str], float], careless: bool, seed: int) -> None:
    """One simulated participant using the pages, where only the names of two films are visible."""
    rng = np.random.default_rng(seed)
    token = page.post("/api/begin").json()["token"]
    state = page.get(f"/api/state/{token}").json()
    while not state["done"]:
        left, right = study.films[state["left"]], study.films[state["right"]]
        swapped = (
            left.condition,
            right.condition,
        ) not in prefers and left.condition != study.design.attention.condition
        a, b = (right, left) if swapped else (left, right)
        a_chosen = chooses_a(Pair(a.condition, b.condition, a.stratum, a.clip, not swapped), prefers, careless, rng)
        answers = {question["name"]: "right" if a_chosen == swapped else "left" for question in state["questions"]}
        sent = page.post(f"/api/state/{token}", json={"trial_index": state["trial_index"], "answers": answers})
        assert sent.status_code == 200, sent.text
        state = sent.json()


def test_choices_on_the_page_are_recorded(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("eyelid_follow"))
    with TestClient(study_app(study), base_url=LOCAL) as page:
        for person, careless in enumerate((False, True, False)):
            visit(page, study, {("following", "static"): 1.0}, careless, person)
    found = study_results(study.root)
    assert (found.participant_count, found.finished, found.failed) == (3, 2, 1)
    answers = study.answers.valid_answers()
    assert {answer.participant for answer in answers} == {0, 2}
    assert len(answers) == 2 * 10 * 2
    assert all(answer.chose_a for answer in answers)  # on either side
    assert len({answer.a_left for answer in answers}) == 2


def test_known_preferences_are_recovered(tmp_path: Path) -> None:
    design = load_design("talkingeyes_table4")
    study = a_study(tmp_path / "study", design)
    known = dict(zip(design.comparisons, (0.9, 0.8, 0.8, 0.7, 0.5, 0.2), strict=True))
    crowd(study, 22, known, careless=2)
    found = study_results(study.root)
    assert (found.participant_count, found.finished, found.failed) == (22, 20, 2)
    rates = {(each.a, each.b): each for each in preference_rates(design, study.answers.valid_answers())}
    for comparison, rate in known.items():
        each = rates[comparison]
        assert each.answers == 100  # 5 from each of 20 participants: 600 in all, as in the paper
        assert abs(each.rate.value - rate) < 0.12
        assert each.rate.low <= each.rate.value <= each.rate.high
        assert (each.wilcoxon_p < 0.05) == (rate != 0.5)
        assert (each.binomial_p < 0.05) == (rate != 0.5)
    lines = found.table.splitlines()
    assert lines[0].startswith("| Method A vs. Method B | Preference Rate |")
    assert [line.split(" | ")[0] for line in lines[2:]] == [
        f"| Ours vs. {name}" for name in ("Mean", "Random", "Similar Sample", "VAE", "Ground Truth")
    ] + ["| Random vs. Ground Truth"]
    assert json.loads((study.root / "results.json").read_text())["failed"] == 2


def test_a_failed_check_ends_the_study_of_probtalk3d(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("probtalk3d_table2"))
    known = dict(zip(study.design.comparisons, (0.4, 0.75, 0.6), strict=True))
    crowd(study, 16, known, careless=1)
    found = study_results(study.root)
    assert (found.finished, found.failed) == (15, 1)
    assert study.answers.participants()[0].trial_index <= 13  # the attention check is in the first half
    assert {answer.participant for answer in study.answers.valid_answers()} == set(range(1, 16))
    header, _, *rows = found.table.splitlines()
    assert "Lip Sync, A | B | p | Realism, A | B | p | Emotional Expression, A" in header
    shares = [float(cell.rstrip("%")) for cell in rows[1].split(" | ")[1:3]]
    assert sum(shares) == pytest.approx(100)
    assert shares[0] > 60


def test_table_of_posegan_has_a_column_per_length(tmp_path: Path) -> None:
    design = load_design("posegan_table4")
    answers = [
        Answer(person, "better", a, b, stratum.name, "c", True, chose_a=(person + place) % 10 < 3)
        for (a, b), stratum, person, place in itertools.product(design.comparisons, design.strata, range(20), range(2))
    ]
    header, _, *rows = table(design, preference_rates(design, answers)).splitlines()
    assert header == "| Method | 4 seconds | 8 seconds | 12 seconds |"
    assert rows[-1].startswith("| PoseGAN | 30.0 (")
    empty = table(design, [])
    assert empty.count("| - | - | - |") == 5


def test_p_values_are_those_of_the_definitions() -> None:
    design = load_design("eyelid_follow")
    answers = [
        Answer(person, "natural", "following", "static", "all_clips", "c", place % 2 == 0, chose_a=place < 8)
        for person in range(5)
        for place in range(10)
    ]
    (found,) = preference_rates(design, answers)
    assert found.binomial_p == pytest.approx(2 * sum(math.comb(50, k) for k in range(11)) / 2**50)
    assert found.wilcoxon_p == pytest.approx(2 / 2**5)  # all five prefer A
    assert (found.wilson_low, found.wilson_high) == pytest.approx((0.6696, 0.8876), abs=1e-3)
    assert math.isnan(wilcoxon_p(np.zeros(4, int)))
    assert (format_p_value(1.68e-4), format_p_value(0.0328), format_p_value(math.nan)) == ("1.68e-4", "3.28e-2", "-")


def test_study_resumes_after_restart_without_personal_data(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("eyelid_follow"))
    page = TestClient(study_app(study), base_url=LOCAL)
    token = page.post("/api/begin").json()["token"]
    state = page.get(f"/api/state/{token}").json()
    choice = {"trial_index": 0, "answers": {"natural": "left", "gaze": "right"}}
    assert page.post(f"/api/state/{token}", json=choice).json()["trial_index"] == 1
    again = TestClient(study_app(Study.load(study.root)), base_url=LOCAL)
    resumed = again.get(f"/api/state/{token}").json()
    assert (state["trial_index"], resumed["trial_index"]) == (0, 1)
    assert again.post(f"/api/state/{token}", json=choice).status_code == 409  # this pair has been answered
    assert again.get(f"/api/state/{token}").json() == resumed
    with sqlite3.connect(study.answers.path) as connection:
        columns = {
            row[1] for table_ in ("participant", "answer") for row in connection.execute(f"pragma table_info({table_})")
        }
    connection.close()
    assert columns == {
        *("number", "token", "trial_index", "attention", "done"),
        *("participant", "question", "a", "b", "stratum", "clip", "a_left", "chose_a"),
    }


def test_pages_do_not_reveal_conditions(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("talkingeyes_table4"))
    page = TestClient(study_app(study), base_url=LOCAL)
    state = page.get(f"/api/state/{page.post('/api/begin').json()['token']}").json()
    assert not any(word in json.dumps(state) for word in ("ours", "truth", "vae", "random", "similar", "all_clips-"))
    film = page.get(f"/films/{state['left']}.mp4", headers={"range": "bytes=0-3"})
    assert (film.status_code, film.content) == (206, b"film")


def test_bad_requests_get_a_reason_and_change_nothing(tmp_path: Path) -> None:
    study = a_study(tmp_path / "study", load_design("eyelid_follow"))
    (study.root / "secret.mp4").write_bytes(b"secret")
    page = TestClient(study_app(study), base_url=LOCAL, raise_server_exceptions=False)
    token = page.post("/api/begin").json()["token"]
    good = {"natural": "left", "gaze": "left"}
    wrong = [
        (b"", 422),
        (b"\xff\x00", 422),
        (b"[" * 4000, 422),
        (b"x" * 5000, 413),
        (b"{}", 422),
        (json.dumps({"trial_index": 0, "answers": {"natural": "left"}}).encode(), 422),
        (json.dumps({"trial_index": 0, "answers": {**good, "natural": "middle"}}).encode(), 422),
        (json.dumps({"trial_index": 0, "answers": good, "number": 1}).encode(), 422),
        (json.dumps({"trial_index": 10**30, "answers": good}).encode(), 422),
        (json.dumps({"trial_index": -1, "answers": good}).encode(), 409),
    ]
    for content, status in wrong:
        answer = page.post(f"/api/state/{token}", content=content)
        assert (answer.status_code, bool(answer.json()["detail"])) == (status, True), content
    assert page.post("/api/state/nobody", json={"trial_index": 0, "answers": good}).status_code == 404
    for path in ("/films/secret.mp4", "/films/..%2fsecret.mp4", "/study.json", "/answers.sqlite", "/../study.json"):
        assert page.get(path).status_code == 404, path
    assert page.get("/", headers={"host": "elsewhere.example"}).status_code == 400
    assert study.answers.participants()[0].trial_index == 0


def toy_data(root: Path, clips: int = 4) -> Path:
    """A data folder: a corpus with truth, and samples of two models, one of faces."""
    rng = np.random.default_rng(0)
    corpus = Corpus(root / "data" / "synthesize")
    corpus.root.mkdir(parents=True)
    index = []
    for number in range(clips):
        name = f"c{number}"
        gaze = angles_to_gaze(rng.normal(0, 0.1, (FRAMES, 2, 2)))
        truth = Motion.of(FPS, rng.normal(0, 0.1, (FRAMES, 3)), gaze, lid=np.full((FRAMES, 2), 0.25))
        sound = rng.normal(0, 0.1, int(FRAMES / FPS * 16_000)).astype(np.float32)
        corpus.write_sound(name, sound, Annotation())
        folder = root / "data" / "sample"
        truth.save(make_shard_path(corpus.root / "truth", name, ".npz"))
        drawn = Samples(FPS, rng.normal(0, 0.1, (2, FRAMES, 3)), np.stack([gaze, gaze]))
        drawn.save(make_shard_path(folder / "talkingeyes_events", name, ".npz"))
        faces = FaceSamples(FPS, np.full((2, FRAMES, 3), 0.1), np.full((2, FRAMES, 1), 0.5), ("jawOpen",), "anny")
        faces.save(make_shard_path(folder / "probtalk3d", name, ".npz"))
        index.append(Clip(name, name, 0, "s", "test", FRAMES / FPS, FPS, "neutral", 0, "en", "", "", "", ""))
    corpus.write_index(index)
    return root / "data"


SMALL = {
    "pool": 2,
    "pairs": 1,
    "name": "all_clips",
    "emotion": None,
    "seconds": 0.2,
}


def test_films_are_rendered_from_a_chain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = toy_data(tmp_path)
    monkeypatch.chdir(tmp_path)
    content = yaml.safe_load((DESIGNS_FOLDER / "eyelid_follow.yaml").read_text())
    Path("own.yaml").write_text(yaml.safe_dump({**content, "strata": [SMALL]}))
    study = make_study("own.yaml", "study", data=data, size=32)
    assert len(list((tmp_path / "study" / "films").iterdir())) == 2 * 2 + 2
    pictures = {}
    for name, film in study.films.items():
        with av.open(str(study.film(name))) as container:
            pictures[film.condition, film.clip] = [
                frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)
            ]
            assert len(container.streams.audio) == 1
    assert {len(frames) for (_, clip), frames in pictures.items() if clip in study.clips["all_clips"]} == {5}
    check = study.clips[ATTENTION_CHECK][0]
    upright, turned = pictures["following", check], pictures["upside_down", check]
    same, other = (np.abs(each.astype(int) - turned[0]).mean() for each in (upright[0][::-1], upright[0]))
    assert 3 * same < other  # not the same bytes, since films are re-encoded
    with pytest.raises(InputError, match="earlier output"):
        make_study("own.yaml", "study", data=data, size=32)


def test_films_show_the_lids_of_a_person_and_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = set()

    def load(eyelid: str, look: str) -> object:
        asked.add((eyelid, look))
        return f"{eyelid} {look}"

    monkeypatch.setattr(study_workflow, "load_shown_head", load)
    monkeypatch.setattr(study_workflow, "retarget_to_head", lambda motion, *_: motion)
    monkeypatch.setattr(study_workflow, "write_film", lambda _, head, __, path: path.write_bytes(head.encode()))
    make_study(
        "eyelid_follow", tmp_path / "study", data=toy_data(tmp_path), allow_fewer=True, eyelid="lids.npz", look="ben"
    )
    worn = [film.read_text() for film in (tmp_path / "study/films").iterdir()]
    assert asked == {("lids.npz", "ben")}
    assert set(worn) == {"lids.npz ben"}


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium; Debian has it in the package chromium")
def test_a_study_is_taken_in_a_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = toy_data(tmp_path)
    monkeypatch.chdir(tmp_path)
    content = yaml.safe_load((DESIGNS_FOLDER / "eyelid_follow.yaml").read_text())
    Path("own.yaml").write_text(yaml.safe_dump({**content, "strata": [SMALL]}))
    make_study("own.yaml", "study", data=data, size=64)
    command = [sys.executable, "-m", "talkingeyes.cli.main", "study", "run", "study", "--port", "0"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
        open_browser(tmp_path / "p") as browser,
    ):
        assert server.stdout is not None
        address = server.stdout.readline().split(" ")[0]
        browser.open(address)
        browser.wait_for("document.body.dataset.state == 'begin'")
        browser.value("document.getElementById('start').click()")
        for place in range(2):
            browser.wait_for(f"document.body.dataset.state == 'pair' && document.body.dataset.trial == '{place}'")
            browser.value("document.querySelectorAll('input[value=left]').forEach((choice) => choice.click())")
            assert browser.value("document.getElementById('next').disabled")  # no film has been watched yet
            for side in ("left", "right"):
                browser.value(f"document.getElementById('{side}').play()")
                browser.wait_for(f"document.getElementById('{side}').classList.contains('seen')")
            browser.value("document.getElementById('next').click()")
            if place == 0:
                browser.wait_for("document.body.dataset.trial == '1'")
                browser.open("about:blank")
                browser.open(address)  # closed and reopened: continues at the same pair
        browser.wait_for("document.body.dataset.state == 'end'")
        server.send_signal(2)
        assert server.wait(timeout=30) == 0
    assert study_results("study").participant_count == 1
    assert Study.load(Path("study")).answers.participants()[0].done


def test_external_films_replace_motions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from talkingeyes.rendering.video import write_video

    data = toy_data(tmp_path)
    for number in range(4):
        frames = (np.full((32, 32, 3), 10 * place, np.uint8) for place in range(FRAMES))
        (tmp_path / "emote").mkdir(exist_ok=True)
        write_video(tmp_path / f"emote/c{number}.mp4", frames, FPS, np.sin(np.arange(9600) / 9).astype(np.float32))
    monkeypatch.chdir(tmp_path)
    content = yaml.safe_load((DESIGNS_FOLDER / "probtalk3d_table2.yaml").read_text())
    Path("own.yaml").write_text(yaml.safe_dump({**content, "strata": [SMALL]}))
    study = make_study("own.yaml", "study", data=data, conditions={"emote": "emote"}, without=["facediffuser"], size=32)
    assert {film.condition for film in study.films.values()} == {"ours", "truth", "emote", "late_sound"}
    own = next(name for name, film in study.films.items() if film.condition == "emote")
    with av.open(str(study.film(own))) as container:
        levels = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
    assert len(levels) == 5
    assert np.allclose(levels, 10 * np.arange(5), atol=4)
    late = next(name for name, film in study.films.items() if film.condition == "late_sound")
    with av.open(str(study.film(late))) as container:
        heard = np.concatenate([frame.to_ndarray()[0] for frame in container.decode(audio=0)])
    assert SOUND_DELAY_S > FRAMES / FPS
    assert np.abs(heard).max() < 0.01  # the film ends before its sound begins


def test_a_film_shows_what_varies_and_shares_the_rest(tmp_path: Path) -> None:
    design = load_design("posegan_table4")
    drawn = Motion.of(FPS, np.full((10, 3), 0.1), np.full((10, 2, 3), 0.2), lid=np.full((10, 2), 0.3))
    truth = Motion.of(FPS, np.full((12, 3), 0.5), np.full((12, 2, 3), 0.6), jaw=np.full((12, 3), 0.7))
    film = film_motion(design, drawn, truth)
    assert len(film) == 10
    assert (film.head[0, 0], film.gaze[0, 0, 0], film.lid[0, 0], film.jaw[0, 0]) == (0.1, 0.0, 0.0, 0.7)
    with pytest.raises(InputError, match="the frame rate of the truth, 25 fps, got 30"):
        film_motion(design, Motion.of(30.0, drawn.head, drawn.gaze), truth)


def test_static_lids_blink_but_do_not_follow() -> None:
    head, still = anny_head(), static_lids(anny_head())
    upper = head.landmarks.names.index("left_eye_upper_outer")

    def height(model: object, pitch_deg: float, lid: float) -> float:
        gaze = angles_to_gaze(np.radians(np.full((1, 2, 2), [0.0, pitch_deg])))
        motion = Motion.of(FPS, np.zeros((1, 3)), gaze, lid=np.full((1, 2), float(lid)))
        return float(head.landmarks.of(posed_vertices(model, motion_to_pose(model, motion)))[0, upper, 1])

    assert height(head, 0, 0) - height(head, -15, 0) > 0.001
    assert height(still, 0, 0) - height(still, -15, 0) == pytest.approx(0, abs=1e-6)
    assert height(still, 0, 0) - height(still, 0, 1) > 0.004


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["make", "duck", "-o", "x"], "design: should be eyelid_follow, posegan_shape"),
        (["make", "none.yaml", "-o", "x"], "none.yaml: not a readable design"),
        (["make", "bad.yaml", "-o", "x"], "bad.yaml.title: is missing"),
        (["make", "talkingeyes_table4", "-o", "x"], "mean: should have motions (.npz) or films (.mp4)"),
        (["make", "eyelid_follow", "-o", "x"], "all_clips: should have 20 clips that all conditions have, got 4"),
        (["make", "eyelid_follow", "-o", "x", "--allow-fewer", "--size", "5"], "size: should be 16 to 1080"),
        (["make", "eyelid_follow", "-o", "x", "--condition", "a"], "condition: should be NAME=DIR, got 'a'"),
        (
            ["make", "eyelid_follow", "-o", "x", "--condition", "a=b"],
            "condition: should be one of following, static, got 'a'",
        ),
        (["make", "eyelid_follow", "-o", "x", "--without", "static"], "without: should leave a comparison"),
        (
            ["make", "eyelid_follow", "-o", "x", "--allow-fewer", "--eyelid", "bad.yaml"],
            "bad.yaml: not a readable Eyelid",
        ),
        (["make", "eyelid_follow", "-o", "data"], "should be a new or empty folder"),
        (["run", "none"], "none/study.json: not a readable study"),
        (["results", "data"], "data/study.json: not a readable study"),
        (["run", "torn"], "torn: should hold 4 films, got none called"),
    ],
)
def test_bad_input_is_one_line_error_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    toy_data(tmp_path)
    monkeypatch.chdir(tmp_path)
    Path("bad.yaml").write_text("design: 1\n")
    if words[-1] == "torn":
        design = load_design("eyelid_follow")
        Path("torn").mkdir()
        Study(Path("torn"), design, 0, {"all_clips": ("c0",), ATTENTION_CHECK: ("c1",)}).save()
    before = sorted(tmp_path.iterdir())
    status = call("study", *words)
    captured = capfd.readouterr()
    assert status == 2
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_invalid_answers_file_is_one_line_error(tmp_path: Path) -> None:
    (tmp_path / "answers.sqlite").write_text("no database " * 100)
    with pytest.raises(InputError, match="should hold the answers of a study"):
        AnswerDatabase(tmp_path / "answers.sqlite").register()


def test_damaged_names_in_an_answers_file_are_one_line_error(tmp_path: Path) -> None:
    answers = AnswerDatabase(tmp_path / "answers.sqlite")
    answers.register()
    content = answers.path.read_bytes()
    answers.path.write_bytes(content.replace(b"CREATE TABLE", b"CREATE T\x9bBLE"))
    with pytest.raises(InputError, match="should hold the answers of a study"):
        answers.register()


def test_samples_of_faces_are_motions(tmp_path: Path) -> None:
    data = toy_data(tmp_path, clips=1)
    (path,) = (data / "sample/probtalk3d").rglob("*.npz")
    motions = load_motions(path)
    assert [motion.jaw[0, 0] for motion in motions] == pytest.approx([0.1, 0.1])
    assert motions[0].expression_names == ("jawOpen",)
    assert not motions[0].head.any()


def test_no_two_films_of_a_study_share_a_name() -> None:
    for name in names():
        design = load_design(name)
        films = required_films(design, pools(design))
        assert len({film_id(0, film) for film in films}) == len(films)
        assert not {film_id(0, film) for film in films} & {film_id(1, film) for film in films}
