// A live stream of `talkingeyes serve` in JavaScript: Float32Array or Int16Array of 16 kHz mono in, rows of poses out.
//
//   const stream = await openStream("ws://127.0.0.1:8030/stream", { seed: 1 }, (frame, row) => show(frame, row));
//   stream.send(samples);         // as often as there is sound, up to 2 s at once
//   stream.set({ eye_contact: 0.8, target: null });   // changes controls while it runs
//   const frames = await stream.end();
//
// A row: translation of the root (3), quaternions x, y, z, w of neck, jaw, left eye, right eye (16), weights of the morph
// targets of /head.glb. With { format: "json" } in the request, onFrame gets a frame as in docs/live.md. Runs in browsers (in
// pages of the service, or of an origin that `serve --origin` names) and in Node.js 22 or later.

export function openStream(url, request, onFrame) {
  return new Promise((resolve, reject) => {
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    let about = null;
    let ended = null;
    const fail = (reason) => (ended ? ended.reject : reject)(new Error(reason));
    socket.onopen = () => socket.send(JSON.stringify(request));
    socket.onerror = () => fail(`${url} cannot be reached`);
    socket.onclose = ({ code, reason }) => code !== 1000 && fail(reason || `closed with code ${code}`);
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") {
        const first = new DataView(data).getUint32(0, true);
        const values = new Float32Array(data, 4);
        for (let row = 0; row * about.columns < values.length; row += 1)
          onFrame(first + row, values.subarray(row * about.columns, (row + 1) * about.columns));
        return;
      }
      const message = JSON.parse(data);
      if (message.error) fail(message.error);
      else if (message.frames && !message.end) message.frames.forEach((frame, at) => onFrame(message.first + at, frame));
      else if (message.set || "behind_s" in message) return; // behind_s: how late frames are
      else if (message.end) ended?.resolve(message.frames);
      else {
        about = message; // { fps, latency_s, format, columns }
        const set = (changes) => socket.send(JSON.stringify({ set: changes }));
        resolve({ ...about, send: (samples) => socket.send(pcm(samples)), set, end });
      }
    };
    function end() {
      socket.send(JSON.stringify({ end: true }));
      return new Promise((resolve, reject) => (ended = { resolve, reject }));
    }
  });
}

function pcm(samples) {
  return samples instanceof Int16Array ? samples : Int16Array.from(samples, (value) => 32767 * Math.max(-1, Math.min(1, value)));
}
