// The page of `talkingeyes serve`. Live: speech from the microphone drives the head (recorder.js). A recording or a file is
// animated and played with its sound; each setting gives another animation of the same sound (apps/service/app.py).

import { openRecording } from "./recorder.js";
import { Stage } from "./stage.js";
import { drawWave, peaks, wavPeaks } from "./waveform.js";

const SMOOTH_S = 0.12; // buffer: extra delay of the display, so that frames arrive in time
const BARS = 300; // of the waveform
const LIVE_BARS = 250; // chunks of the microphone that are shown: ten seconds
const KEPT = 12; // animations of one sound that the page keeps, fewer than the service (workflows/serve.py, max_results)
const SAMPLES = 3;
const TITLES = { glb: "GLB", arkit: "ARKit JSON", livelink: "Live Link CSV", mp4: "Film (MP4)" };
const $ = (id) => document.getElementById(id);

let stage, about, speech, shown, recording;
let asked = 0;
let bars = new Float32Array(BARS);
let made = new Map(); // query -> animation of the speech

async function open() {
  about = await answer(await fetch("service.json"));
  stage = await Stage.open($("head"), "head.glb", [$("head")]);
  const form = $("request");
  form.person.append(...about.persons.map((name) => new Option(name)));
  $("who").hidden = !about.persons.length;
  $("limit").textContent = `At most ${about.max_seconds} s and ${about.max_megabytes} MB.`;
  $("record").disabled = false;
  $("record").onclick = () => (recording ? recording.stop() : record().catch(failed));
  $("emotions").append(...about.emotions.map((name) => choice("emotion", name, name)));
  addSamples();
  wireControls(form);
  wireFiles();
  numbers();
  say("ready", "choose a recording, or record");
  requestAnimationFrame(draw);
}

function wireControls(form) {
  $("another").onclick = () => {
    $("samples").append(sample($("samples").children.length));
    $("samples").lastChild.control.checked = true;
    perform();
  };
  $("first").onchange = () => addSamples();
  $("own").onchange = () => (form.eye_contact.disabled = $("own").checked);
  form.onsubmit = (event) => event.preventDefault();
  form.oninput = numbers;
  form.onchange = ({ target }) => {
    form.intensity.disabled = form.emotion?.value === "neutral";
    if (recording) recording.set(changeable());
    else if (!["face", "keep", "rate", "state"].includes(target.id)) perform();
  };
  $("seek").oninput = () => ($("sound").currentTime = $("seek").value);
  $("view").onchange = ({ target }) => stage.look(target.value);
  $("rays").onchange = ({ target }) => stage.showRays(target.checked);
}

// Files are chosen, or dropped anywhere on the page.
function wireFiles() {
  $("upload").onchange = ({ target }) => target.files[0] && load(target.files[0]);
  $("face").onchange = ({ target }) => target.files[0] && addEyes(target.files[0]).catch(failed).finally(() => (target.value = ""));
  addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  addEventListener("dragleave", (event) => event.relatedTarget ?? document.body.classList.remove("dropping"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    if (!event.dataTransfer.files[0] || recording) return;
    $("upload").files = event.dataTransfer.files; // shows the name
    load(event.dataTransfer.files[0]);
  });
}

function choice(name, value, text) {
  const label = document.createElement("label");
  label.append(Object.assign(document.createElement("input"), { type: "radio", name, value, checked: value === "neutral" }), text);
  return label;
}

function sample(index) {
  const label = choice("seed", Number($("first").value) + index, `Sample ${index + 1}`);
  label.title = `seed ${label.control.value}`;
  return label;
}

function addSamples() {
  $("samples").replaceChildren(...Array.from({ length: SAMPLES }, (_, index) => sample(index)));
  $("samples").firstChild.control.checked = true;
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

async function content(address, request) {
  const response = await fetch(address, request);
  return response.ok ? response : answer(response);
}

function numbers() {
  for (const range of $("request").querySelectorAll('input[type="range"]')) range.nextElementSibling.textContent = range.value;
}

function requested() {
  const form = $("request");
  const emotion = form.emotion.value;
  const asks = {
    seed: Number(form.seed.value),
    blinks: form.blinks.value,
    emotion,
    intensity: emotion === "neutral" ? 0 : Number(form.intensity.value),
    head_liveliness: Number(form.head_liveliness.value),
    gaze_liveliness: Number(form.gaze_liveliness.value),
    blink_liveliness: Number(form.blink_liveliness.value),
  };
  if (form.person.value) asks.person = form.person.value;
  if (!$("own").checked) asks.eye_contact = Number(form.eye_contact.value);
  return asks;
}

// What can be changed while a recording runs.
function changeable() {
  const { head_liveliness, gaze_liveliness, eye_contact = null } = requested();
  return { head_liveliness, gaze_liveliness, eye_contact, state: $("state").value || null };
}

// A new sound, from its beginning.
function load(sound) {
  if (recording) return;
  speech = sound;
  made = new Map();
  shown = null;
  $("sound").pause();
  URL.revokeObjectURL($("sound").src);
  $("sound").removeAttribute("src");
  $("seek").disabled = $("face").disabled = true;
  $("downloads").textContent = "Available after an animation has been made.";
  perform();
}

// Animate the sound with the settings of the page. Only the result of the newest request is shown; the sound plays on.
async function perform() {
  if (!speech || recording) return;
  const turn = ++asked;
  const query = `${new URLSearchParams(requested())}`;
  try {
    if (!made.has(query)) {
      say("working", "animating");
      const animation = await animate(query);
      if (turn !== asked) return;
      made.set(query, animation);
      if (made.size > KEPT) made.delete(made.keys().next().value);
    }
    shown = made.get(query);
    if (!$("sound").hasAttribute("src")) await hear(shown);
    offer(shown.place);
    $("face").disabled = false;
    say("playing", `${shown.seconds.toFixed(2)} s, ${shown.frames} frames`);
    if ($("sound").paused && !$("sound").currentTime) await $("sound").play().catch(() => say("playing", "press play"));
  } catch (error) {
    if (turn === asked) failed(error);
  }
}

async function animate(query) {
  const performed = await answer(await fetch(`performances?${query}`, { method: "POST", body: speech }));
  const place = `performances/${performed.id}`;
  const rows = new Float32Array(await (await content(`${place}/poses`)).arrayBuffer());
  return { ...performed, place, rows };
}

// Load the sound of an animation as the service heard it, and its waveform.
async function hear({ place, seconds }) {
  const sound = await (await content(`${place}/sound`)).arrayBuffer();
  bars = wavPeaks(sound, BARS);
  Object.assign($("seek"), { max: seconds, value: 0, disabled: false });
  $("sound").src = URL.createObjectURL(new Blob([sound], { type: "audio/wav" }));
}

function offer(place) {
  const [main, more] = [document.createElement("div"), document.createElement("details")];
  main.className = "main";
  main.append(...Object.keys(TITLES).filter((name) => about.formats.includes(name)).map((name) => link(`${place}/${name}`, TITLES[name])));
  const others = about.formats.filter((name) => !TITLES[name]);
  more.append(Object.assign(document.createElement("summary"), { textContent: "Other formats" }), ...others.map((name) => link(`${place}/${name}`, name)));
  more.open = $("downloads").querySelector("details")?.open ?? false;
  $("downloads").replaceChildren(main, more);
}

// The first click requests the export and reports errors; then the file is downloaded.
function link(href, textContent) {
  const made = Object.assign(document.createElement("a"), { href, textContent, download: "" });
  made.onclick = async (event) => {
    if (made.dataset.made) return;
    event.preventDefault();
    if (made.ariaBusy === "true") return;
    made.ariaBusy = "true";
    say("playing", `making ${textContent}`);
    try {
      await content(href);
      made.dataset.made = "yes";
      made.click();
      say("playing", `${textContent} is downloaded`);
    } catch (error) {
      failed(error);
    } finally {
      made.ariaBusy = "false";
    }
  };
  return made;
}

// Face motion of another program comes back with the eyes of the animation that is shown.
async function addEyes(file) {
  const ending = /\.(csv\.gz|[^.]+)$/i.exec(file.name)?.[1].toLowerCase() ?? "";
  say("playing", `adding eyes to ${file.name}`);
  const query = new URLSearchParams({ keep_head: $("keep").checked, ...($("rate").value && { fps: $("rate").value }) });
  const address = `${shown.place}/faces/${encodeURIComponent(ending)}?${query}`;
  const type = "application/octet-stream";
  const edited = await (await content(address, { method: "POST", body: file, headers: { "Content-Type": type } })).blob();
  const saved = Object.assign(document.createElement("a"), { href: URL.createObjectURL(edited), download: `eyes_${file.name}` });
  saved.click();
  say("playing", `${saved.download} is downloaded`);
}

// The recording is kept, and animated as a file at the end.
async function record() {
  $("record").disabled = true;
  try {
    $("sound").pause();
    recording = await openRecording({ ...requested(), ...changeable() }, { begun, heard, ended, failed });
    shown = null;
    bars = new Float32Array(LIVE_BARS);
    $("record").textContent = "Stop";
    Object.assign($("level"), { hidden: false, value: $("level").min });
    $("seek").disabled = true;
  } finally {
    $("record").disabled = false;
  }
}

function begun({ latency_s }) {
  const latency_ms = Math.round(1000 * (latency_s + SMOOTH_S));
  say("live", `live: latency ${latency_ms} ms`);
}

// Level in dB of full scale, and the last ten seconds of the waveform.
function heard(samples) {
  const power = samples.reduce((sum, sample) => sum + sample * sample, 0) / samples.length;
  const level = Math.max($("level").min, 10 * Math.log10(power + 1e-9));
  $("level").value = level;
  $("level").textContent = `${Math.round(level)} dB`;
  bars.copyWithin(0, 1);
  bars.set(peaks(samples, 1), LIVE_BARS - 1);
}

function ended(sound) {
  recording = null;
  $("record").textContent = "Record";
  $("level").hidden = true;
  if (sound) load(sound);
}

function draw() {
  const row = recording ? liveRow(recording) : shownRow();
  if (row) stage.pose(0, row);
  stage.draw();
  drawWave($("wave"), bars, recording ? 1 : $("sound").currentTime / $("seek").max);
  if (shown) {
    $("seek").value = $("sound").currentTime;
    $("seek").ariaValueText = `${$("sound").currentTime.toFixed(1)} of ${shown.seconds.toFixed(1)} seconds`;
  }
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

open().catch(failed);
