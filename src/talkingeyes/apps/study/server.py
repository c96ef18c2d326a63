"""The study as local web pages: start, pair after pair, end. Each step is one JSON; the page stores only a token.

The server alone knows the conditions: the page gets two opaque film names and sends left or right.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from fastapi import FastAPI, HTTPException, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import FileResponse
from pydantic import ValidationError

from talkingeyes.apps.study.answers import Participant
from talkingeyes.apps.study.study_folder import Study
from talkingeyes.apps.viewer.assets import read_assets
from talkingeyes.apps.viewer.local_server import LOCALHOST, create_app, serve_files
from talkingeyes.core.containers import parse_json
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import Settings

ASSETS = Path(__file__).parent / "assets"
MAX_BODY_BYTES = 4096  # maximum size of a request


class PairResponse(Settings):
    """Answer of the page: index of the pair, and the chosen side for each question."""

    trial_index: int
    answers: dict[str, Literal["left", "right"]]


def study_app(study: Study, host: str = LOCALHOST) -> FastAPI:
    """The application of one study."""
    app = create_app(host)

    @app.post("/api/begin")
    def register() -> dict[str, str]:
        try:
            return {"token": study.answers.register()}
        except InputError as error:
            raise HTTPException(429, str(error)) from None

    @app.get("/api/state/{token}")
    def state(token: str) -> dict[str, Any]:
        return _state(study, _who(study, token))

    @app.post("/api/state/{token}")
    async def answer(token: str, request: Request) -> dict[str, Any]:
        choice = await _choice(request)
        return await run_in_threadpool(_answered, study, token, choice)

    @app.get("/films/{name}.mp4")
    def film(name: str) -> FileResponse:
        if name not in study.films:
            raise HTTPException(404, f"should be a film of this study, got {name[:100]!r}")
        return FileResponse(study.film(name), media_type="video/mp4")

    serve_files(app, read_assets(ASSETS, ("study.css", "study.html", "study.js")))
    return app


def _who(study: Study, token: str) -> Participant:
    found = study.answers.participant(token)
    if found is None:
        raise HTTPException(404, "token: should be that of a participant of this study")
    return found


async def _choice(request: Request) -> PairResponse:
    """The validated content of a request."""
    sent = b""
    async for chunk in request.stream():
        sent += chunk
        if len(sent) > MAX_BODY_BYTES:
            raise HTTPException(413, f"an answer should have at most {MAX_BODY_BYTES} bytes")
    try:
        return PairResponse.model_validate(parse_json(sent))
    except ValueError as error:
        first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else "not JSON"
        raise HTTPException(
            422, f"an answer should have a trial_index and left or right for each question: {first}"
        ) from None


def _answered(study: Study, token: str, choice: PairResponse) -> dict[str, Any]:
    who = _who(study, token)
    pairs = study.pairs(who.number)
    asked = {question.name for question in study.design.questions}
    if set(choice.answers) != asked:
        raise HTTPException(422, f"answers: should be about {', '.join(sorted(asked))}")
    if who.done or choice.trial_index != who.trial_index:
        raise HTTPException(409, f"trial_index: should be {who.trial_index}, got {choice.trial_index}")
    pair = pairs[who.trial_index]
    choices = {name: (side == "left") == pair.a_left for name, side in choice.answers.items()}
    last = who.trial_index + 1 == len(pairs)
    if not study.answers.add(who, pair, choices, last, study.design.attention.ends_study):
        raise HTTPException(409, "trial_index: this pair was already answered")
    return _state(study, _who(study, token))


def _state(study: Study, who: Participant) -> dict[str, Any]:
    """The next state of the page."""
    pairs = study.pairs(who.number)
    said = {
        "title": study.design.title,
        "introduction": study.design.introduction,
        "of": len(pairs),
        "trial_index": who.trial_index,
    }
    if who.done:
        return {**said, "done": True}
    left, right = study.names(pairs[who.trial_index])
    questions = [{"name": question.name, "text": question.text} for question in study.design.questions]
    return {**said, "done": False, "left": left, "right": right, "questions": questions}
