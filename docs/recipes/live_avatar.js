// Speech of a file or the microphone to a live stream of `talkingeyes serve`, and the frame that is due: for pages that drive
// an avatar (vrm_live.html, talkinghead_live.html).
//
//   const live = await openLive({ service: "ws://127.0.0.1:8030/stream", sound: "SPEECH.wav", request: { seed: 1 } });
//   live.due();                          // the frame to show now (docs/live.md), null before the first
//   live.set({ eye_contact: 0.8 });      // changes controls
//   await live.ended;                    // the number of frames, when the sound is over; live.stop() ends the microphone
//
// Without `sound` the microphone is used. A file is played as late as its frames are shown, so both are in step.

import { openStream } from "./stream_client.js";

const RATE = 16000, CHUNK = 640, SMOOTH_S = 0.12; // extra delay, so that frames arrive in time
const MICROPHONE = `registerProcessor("microphone", class extends AudioWorkletProcessor {
  process([[samples]]) { if (samples) this.port.postMessage(samples.slice()); return true; } });`;

export async function openLive({ service, sound = null, request = {} }) {
  const frames = [];
  const context = new AudioContext({ sampleRate: RATE });
  const source = sound ? await fileOf(context, sound) : await microphone(context);
  const stream = await openStream(service, { ...request, format: "json" }, (number, frame) => (frames[number] = frame));
  const delay_s = stream.latency_s + SMOOTH_S;
  const began = performance.now();
  const over = source.start(stream.send, delay_s);
  const ended = over.then(() => stream.end()).finally(() => context.close());
  function due() {
    const at = Math.floor(((performance.now() - began) / 1000 - delay_s) * stream.fps);
    return frames[Math.min(at, frames.length - 1)] ?? null;
  }
  return { frames, due, set: stream.set, stop: source.stop, ended, latency_s: delay_s };
}

// Starts and stops a stream by clicks on the picture, and sends what the form says while it runs. The address of the page
// may name a service and a sound. `changes` gives the controls, `ended` is called at the end.
export function controlLive({ form, output, picture, changes, ended = () => {} }) {
  const asked = new URLSearchParams(location.search);
  let live = null;
  async function start() {
    if (live || output.value === "starting") return;
    output.value = "starting";
    try {
      live = await openLive({ service: asked.get("service") ?? "ws://127.0.0.1:8030/stream", sound: asked.get("sound"), request: changes() });
      output.value = `live, ${Math.round(1000 * live.latency_s)} ms late`;
      document.title = `ended after ${await live.ended} frames`;
      output.value = "click the picture to start";
    } catch (error) {
      document.title = output.value = error.message;
    }
    window.last = live; // for tests and the curious
    live = null;
    ended();
  }
  picture.addEventListener("click", () => (live ? live.stop() : start()));
  form.oninput = () => live?.set(changes());
  form.onsubmit = (event) => event.preventDefault();
  return { start, due: () => live?.due() ?? null, send: () => live?.set(changes()) };
}

async function fileOf(context, address) {
  const buffer = await context.decodeAudioData(await (await fetch(address)).arrayBuffer()); // at 16 kHz
  const samples = buffer.getChannelData(0);
  let stopped = false;
  async function start(send, delay_s) {
    const player = new AudioBufferSourceNode(context, { buffer });
    player.connect(context.destination);
    player.start(context.currentTime + delay_s);
    const began = performance.now();
    for (let at = 0; at < samples.length && !stopped; at += CHUNK) {
      const early = (1000 * (at + CHUNK)) / RATE - (performance.now() - began);
      if (early > 0) await new Promise((resolve) => setTimeout(resolve, early));
      send(samples.subarray(at, at + CHUNK));
    }
  }
  return { start, stop: () => (stopped = true) };
}

async function microphone(context) {
  const media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1 } });
  const module = URL.createObjectURL(new Blob([MICROPHONE], { type: "text/javascript" }));
  await context.audioWorklet.addModule(module);
  const node = new AudioWorkletNode(context, "microphone");
  let stop;
  const over = new Promise((resolve) => (stop = resolve));
  async function start(send) {
    let waiting = [];
    node.port.onmessage = ({ data }) => {
      waiting.push(...data);
      if (waiting.length < CHUNK) return;
      send(Float32Array.from(waiting));
      waiting = [];
    };
    context.createMediaStreamSource(media).connect(node);
    await over;
    node.port.onmessage = null;
    media.getTracks().forEach((track) => track.stop());
  }
  return { start, stop };
}
