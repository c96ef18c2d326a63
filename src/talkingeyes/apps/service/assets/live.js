// The page of `talkingeyes serve`. Live: speech from the microphone drives the head (apps/service/live_stream.py). A recording or
// a file is animated and played with its sound, again after every change of a control (apps/service/app.py).

import { Stage } from "./stage.js";

const RATE = 16000;
const SMOOTH_S = 0.12; // buffer: extra delay of the display, so that frames arrive in time
const $ = (id) => document.getElementById(id);

let stage, about, speech, shown, recording;
let asked = 0;

async function open() {
  about = await answer(await fetch("service.json"));
  stage = await Stage.open($("head"), "head.glb", [$("head")]);
  $("request").person.append(...about.persons.map((name) => new Option(name)));
  $("who").hidden = !about.persons.length;
  $("record").disabled = !about.live;
  $("record").title = about.live ? "" : "no streaming model is loaded";
  $("record").onclick = () => (recording ? recording.stop() : record()).catch?.(failed);
  $("upload").onchange = ({ target }) => target.files[0] && perform(target.files[0]);
  $("another").onclick = () => {
    $("request").seed.value = Math.floor(Math.random() * 2 ** 31);
    perform(speech);
  };
  $("own").onchange = () => {
    $("request").eye_contact.disabled = $("own").checked;
    perform(speech);
  };
  $("request").onsubmit = (event) => event.preventDefault();
  $("request").oninput = numbers;
  $("request").onchange = ({ target }) => target.id !== "own" && perform(speech);
  numbers();
  say("ready", "record or upload speech");
  requestAnimationFrame(draw);
}

function say(state, text) {
  document.body.dataset.state = state;
  $("status").textContent = text;
}

function failed(error) {
  say("error", error.message);
}

async function answer(response) {
  if (response.ok) return response.json();
  const content = await response.json().catch(() => ({}));
  throw new Error(content.error ?? `the service returned status ${response.status}`);
}

function numbers() {
  for (const range of document.querySelectorAll('input[type="range"]')) range.nextElementSibling.textContent = range.value;
}

function requested() {
  const form = $("request");
  const neutral = form.emotion.value === "neutral";
  const asks = {
    seed: Number(form.seed.value),
    blinks: form.blinks.value,
    emotion: form.emotion.value,
    intensity: neutral ? 0 : Number(form.intensity.value),
    head_liveliness: Number(form.head_liveliness.value),
    gaze_liveliness: Number(form.gaze_liveliness.value),
    blink_liveliness: Number(form.blink_liveliness.value),
  };
  if (form.person.value) asks.person = form.person.value;
  if (!$("own").checked) asks.eye_contact = Number(form.eye_contact.value);
  return asks;
}

// Animate a whole sound. Only the result of the newest request is shown.
async function perform(sound) {
  if (!sound || recording) return;
  const turn = ++asked;
  speech = sound;
  say("working", "working");
  try {
    const made = await answer(await fetch(`performances?${new URLSearchParams(requested())}`, { method: "POST", body: sound }));
    const place = `performances/${made.id}`;
    const poses = await fetch(`${place}/poses`);
    if (!poses.ok) throw new Error("the poses could not be loaded");
    const rows = new Float32Array(await poses.arrayBuffer());
    if (turn !== asked) return;
    shown = { ...made, rows };
    $("sound").src = `${place}/sound`;
    offer(place);
    say("playing", `${made.seconds.toFixed(2)} s, ${made.frames} frames`);
    await $("sound").play().catch(() => say("playing", "press play"));
  } catch (error) {
    if (turn === asked) failed(error);
  }
}

function offer(place) {
  $("downloads").replaceChildren("Download: ", ...about.formats.map((format) => link(`${place}/${format}`, format)));
}

// The first click requests the export and reports errors; then the file is downloaded.
function link(href, textContent) {
  const made = Object.assign(document.createElement("a"), { href, textContent, download: "" });
  made.onclick = async (event) => {
    if (made.dataset.made) return;
    event.preventDefault();
    try {
      const file = await fetch(href);
      if (!file.ok) await answer(file);
      made.dataset.made = "yes";
      made.click();
    } catch (error) {
      failed(error);
    }
  };
  return made;
}

// Send sound in chunks of 40 ms and receive rows of poses. The recording is kept, and animated as a file at the end.
async function record() {
  const media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1 } });
  const context = new AudioContext({ sampleRate: RATE });
  await context.audioWorklet.addModule("microphone.js");
  const socket = new WebSocket(Object.assign(new URL("stream", location), { protocol: location.protocol.replace("http", "ws") }));
  socket.binaryType = "arraybuffer";
  const heard = [];
  const live = { rows: [], began: null, fps: 25, latency_s: 0, columns: 0 };
  const node = new AudioWorkletNode(context, "microphone");
  const silence = () => {
    media.getTracks().forEach((track) => track.stop());
    context.close();
  };
  socket.onopen = () => socket.send(JSON.stringify(requested()));
  socket.onmessage = ({ data }) => {
    if (data instanceof ArrayBuffer) return arrived(live, data);
    const message = JSON.parse(data);
    if (message.error) failed(new Error(message.error));
    else if (message.end) live.frames = message.frames;
    else {
      Object.assign(live, message);
      context.createMediaStreamSource(media).connect(node);
      say("live", `live: latency ${Math.round(1000 * (live.latency_s + SMOOTH_S))} ms`);
    }
  };
  node.port.onmessage = ({ data }) => {
    live.began ??= performance.now();
    heard.push(data);
    if (socket.readyState === WebSocket.OPEN) socket.send(pcm([data]).buffer);
  };
  socket.onclose = () => {
    silence();
    recording = null;
    $("record").textContent = "Record";
    if (document.body.dataset.state !== "error" && heard.length) perform(wav(heard));
  };
  $("sound").pause();
  shown = null;
  $("record").textContent = "Stop";
  recording = {
    live,
    async stop() {
      node.port.onmessage = null;
      silence();
      socket.send(JSON.stringify({ end: true }));
    },
  };
}

function arrived(live, data) {
  const rows = new Float32Array(data.slice(4));
  for (let at = 0; at < rows.length; at += live.columns) live.rows.push(rows.subarray(at, at + live.columns));
  document.body.dataset.frames = live.rows.length;
}

function draw() {
  const row = recording ? liveRow(recording.live) : shownRow();
  if (row) stage.pose(0, row);
  stage.draw();
  requestAnimationFrame(draw);
}

function liveRow({ rows, began, fps, latency_s }) {
  if (!rows.length) return null;
  const now = ((performance.now() - began) / 1000 - latency_s - SMOOTH_S) * fps;
  return rows[Math.max(0, Math.min(Math.floor(now), rows.length - 1))];
}

function shownRow() {
  if (!shown) return null;
  const frame = Math.min(Math.floor($("sound").currentTime * shown.fps), shown.frames - 1);
  return shown.rows.subarray(frame * shown.columns, (frame + 1) * shown.columns);
}

function pcm(chunks) {
  const samples = chunks.flatMap((chunk) => [...chunk]);
  return Int16Array.from(samples, (sample) => Math.max(-32768, Math.min(32767, Math.round(sample * 32767))));
}

function wav(chunks) {
  const samples = pcm(chunks);
  const view = new DataView(new ArrayBuffer(44));
  const text = (at, letters) => [...letters].forEach((letter, index) => view.setUint8(at + index, letter.charCodeAt(0)));
  text(0, "RIFF");
  view.setUint32(4, 36 + samples.byteLength, true);
  text(8, "WAVEfmt ");
  [[16, 16], [28, 2 * RATE], [24, RATE], [40, samples.byteLength]].forEach(([at, value]) => view.setUint32(at, value, true));
  [[20, 1], [22, 1], [32, 2], [34, 16]].forEach(([at, value]) => view.setUint16(at, value, true));
  text(36, "data");
  return new Blob([view, samples], { type: "audio/wav" });
}

open().catch(failed);
