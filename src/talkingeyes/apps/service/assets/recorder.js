// Speech from the microphone, sent as a live stream (apps/service/live_stream.py) in chunks of 40 ms.
//
//   const recording = await openRecording(request, { begun, heard, ended, failed });
//   recording.rows;    // rows of poses so far; `recording.began`, `fps`, `latency_s` say when each is due
//   recording.set({ eye_contact: 0.8 });  // changes controls while it runs
//   recording.stop();  // `ended(wav)` is called with the recording when the stream has ended
//
// `heard(samples)` is called for each chunk, a Float32Array.

const RATE = 16000;

export async function openRecording(request, { begun, heard, ended, failed }) {
  if (!navigator.mediaDevices) throw new Error("browsers give the microphone only to pages at https or localhost");
  const media = await navigator.mediaDevices.getUserMedia({ audio: { channelCount: 1 } });
  const context = new AudioContext({ sampleRate: RATE });
  const silence = () => {
    media.getTracks().forEach((track) => track.stop());
    if (context.state !== "closed") context.close();
  };
  await context.audioWorklet.addModule("microphone.js").catch((error) => {
    silence();
    throw error;
  });
  const node = new AudioWorkletNode(context, "microphone");
  const chunks = [];
  const address = Object.assign(new URL("stream", location), { protocol: location.protocol.replace("http", "ws") });
  const socket = Object.assign(new WebSocket(address), { binaryType: "arraybuffer" });
  const live = { rows: [], began: null, fps: 25, latency_s: 0, columns: 0 };
  let broken = false;
  const broke = (reason) => {
    broken = true;
    failed(new Error(reason));
  };
  socket.onopen = () => socket.send(JSON.stringify(request));
  socket.onmessage = ({ data }) => {
    if (data instanceof ArrayBuffer) return arrived(live, data);
    const message = JSON.parse(data);
    if (message.error) broke(message.error);
    else if (message.fps) {
      Object.assign(live, message);
      context.createMediaStreamSource(media).connect(node);
      begun(live);
    }
  };
  node.port.onmessage = ({ data }) => {
    live.began ??= performance.now();
    chunks.push(data);
    heard(data);
    if (socket.readyState === WebSocket.OPEN) socket.send(pcm([data]).buffer);
  };
  socket.onerror = () => broke("the service cannot be reached");
  socket.onclose = () => {
    silence();
    ended(broken || !chunks.length ? null : wav(chunks));
  };
  live.set = (changes) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify({ set: changes }));
  live.stop = () => {
    node.port.onmessage = null;
    silence();
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ end: true }));
  };
  return live;
}

function arrived(live, data) {
  const rows = new Float32Array(data.slice(4));
  for (let at = 0; at < rows.length; at += live.columns) live.rows.push(rows.subarray(at, at + live.columns));
  document.body.dataset.frames = live.rows.length;
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
