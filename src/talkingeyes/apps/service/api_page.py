"""The description of the service for programs: what its OpenAPI schema says of each request, and a page of it.

The page is plain HTML without scripts: Swagger UI needs another host or scripts within the page, which the
Content-Security-Policy of local_server.py forbids. The schema itself is at /openapi.json for tools that read it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

from pydantic import BaseModel, Field

from talkingeyes.apps.service.animation_request import AnimationRequest, EyesRequest, StreamChanges, StreamRequest
from talkingeyes.core.settings import Settings

TEMPLATE = Path(__file__).parent / "assets" / "api.html"
BINARY = {"schema": {"type": "string", "format": "binary"}}


class PerformanceReply(BaseModel):
    """A finished animation."""

    id: str
    seconds: float
    fps: float
    frames: int
    columns: int = Field(description="numbers a frame of `poses`")


class ServiceReply(BaseModel):
    """What a service offers."""

    formats: list[str] = Field(description="export formats")
    persons: list[str] = Field(description="training speakers of the model")
    emotions: list[str] = Field(description="of the face")
    max_seconds: float = Field(description="of a sound")
    max_megabytes: float = Field(description="of a file")


class HealthReply(BaseModel):
    """How live streams are doing."""

    behind: bool = Field(description="whether frames are late")
    streams: int
    load: float = Field(description="share of time that the busiest process works on streams; 0.65 at most")
    lateness_s: float = Field(description="99th percentile of how late frames are beyond latency_s")


class ErrorReply(BaseModel):
    """A mistake, in one line."""

    error: str


def _query(settings: type[Settings]) -> list[dict[str, Any]]:
    """Query parameters of a request, as OpenAPI."""
    properties = settings.model_json_schema()["properties"]
    return [{"name": name, "in": "query", "required": False, "schema": schema} for name, schema in properties.items()]


def _body(what: str) -> dict[str, Any]:
    return {"required": True, "description": what, "content": {"application/octet-stream": BINARY}}


def _example(command: str) -> list[dict[str, str]]:
    return [{"lang": "shell", "source": command}]


FILE = {"200": {"description": "The file", "content": {"application/octet-stream": BINARY}}}
PERFORM_DOCS = {
    "parameters": _query(AnimationRequest),
    "requestBody": _body("The sound file itself (wav, flac, ogg, mp3, m4a, webm), not a form"),
    "x-codeSamples": _example('curl --data-binary @speech.wav "$SERVICE/performances?seed=1&head_liveliness=1.5"'),
}
DOWNLOAD_DOCS = {
    "responses": FILE,
    "x-codeSamples": _example(
        'curl -o head.glb "$SERVICE/performances/ID/glb"\ncurl -o head.json "$SERVICE/performances/ID/arkit"'
    ),
}
ADD_EYES_DOCS = {
    "parameters": _query(EyesRequest),
    "requestBody": _body(
        "The face motion itself; `ending` is that of its file name: csv, csv.gz, json, glb, vrma, npz, npy"
    ),
    "responses": FILE,
    "x-codeSamples": _example(
        'curl --data-binary @lips.csv -o with_eyes.csv "$SERVICE/performances/ID/faces/csv?blend=1"'
    ),
}


def api_page(schema: Mapping[str, Any], address: str) -> str:
    """The page of a service at `address`: its schema, and the WebSocket protocol, for which OpenAPI has no place."""
    operations = "\n".join(
        _operation(method.upper(), path, operation, schema["components"]["schemas"])
        for path, methods in schema["paths"].items()
        for method, operation in methods.items()
    )
    return Template(TEMPLATE.read_text()).substitute(
        operations=operations,
        stream_request=_keys(StreamRequest, ("person", "fps")),
        stream_changes=_keys(StreamChanges, has_defaults=False),
        address=escape(address),
        socket=escape(address.replace("http", "ws", 1)),
        version=escape(schema["info"]["version"]),
    )


def _keys(settings: type[Settings], without: Sequence[str] = (), has_defaults: bool = True) -> str:
    """A table of the keys of a message."""
    rows = [(each["name"], *_type(each["schema"])) for each in _query(settings) if each["name"] not in without]
    if has_defaults:
        return _table(("key", "type", "default", "meaning"), rows)
    return _table(("key", "type", "meaning"), [(name, type, meaning) for name, type, _, meaning in rows])


def _operation(method: str, path: str, operation: Mapping[str, Any], schemas: Mapping[str, Any]) -> str:
    parts = [f"<h3><code>{method} {escape(path)}</code></h3><p>{escape(operation['summary'])}</p>"]
    if parameters := operation.get("parameters"):
        rows = [(each["name"], each["in"], *_type(each["schema"])) for each in parameters]
        parts.append(_table(("parameter", "in", "type", "default", "meaning"), rows))
    if body := operation.get("requestBody"):
        parts.append(f"<p>Body: {escape(body['description'])}.</p>")
    answers = []
    for status, answer in operation["responses"].items():
        kind = next(iter(answer.get("content", {"": {}}).values())).get("schema", {})
        fields = schemas[kind["$ref"].rpartition("/")[2]]["properties"] if "$ref" in kind else {}
        described = ", ".join(f"{name}: {_type(field)[0]}" for name, field in fields.items())
        answers.append((status, answer["description"], f"{{{described}}}" if described else "binary"))
    parts.append(_table(("status", "meaning", "answer"), answers))
    parts += [f"<pre><code>{escape(each['source'])}</code></pre>" for each in operation.get("x-codeSamples", ())]
    return "<section>" + "".join(parts) + "</section>"


def _type(schema: Mapping[str, Any]) -> tuple[str, str, str]:
    """Type with its bounds, default and meaning of a value; of `value or null`, those of the value."""
    alternatives = [each for each in schema.get("anyOf", (schema,)) if each.get("type") != "null"]
    chosen, name = alternatives[0], " | ".join(map(_name, alternatives))
    bounds = [
        f"{sign} {json.dumps(chosen[key])}"
        for key, sign in (("minimum", "≥"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if key in chosen
    ]
    default = schema.get("default")
    meaning = chosen.get("description", schema.get("description", ""))
    return " ".join([name, *bounds]), "" if default is None else json.dumps(default), meaning


def _name(schema: Mapping[str, Any]) -> str:
    """The type of a value without its bounds."""
    if "enum" in schema:
        return " | ".join(schema["enum"])
    if schema.get("type") == "array":
        return f"[{', '.join(each['type'] for each in schema.get('prefixItems', (schema.get('items'),)))}]"
    return str(schema.get("type", ""))


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    titles = "".join(f'<th scope="col">{each}</th>' for each in head)
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="table"><table><thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table></div>'
