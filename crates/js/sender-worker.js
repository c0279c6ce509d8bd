// The worker of SenderWorker in handcast-sender.js: pictures in, planes out, one after the other.

import { loadSender } from "./handcast-sender.js";

let sender;
let canvas;
let longest = 640;

/** The pixels of a picture, no larger than they are looked at. */
function pixels(picture) {
  if (picture.data) return picture;
  const width = picture.displayWidth ?? picture.width;
  const height = picture.displayHeight ?? picture.height;
  const scale = Math.min(1, longest / Math.max(width, height));
  const [w, h] = [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
  if (canvas?.width !== w || canvas?.height !== h) canvas = new OffscreenCanvas(w, h);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "medium";
  try {
    context.drawImage(picture, 0, 0, w, h);
  } finally {
    picture.close();
  }
  return context.getImageData(0, 0, w, h);
}

async function start({ options, wasm }) {
  const { Sender } = await loadSender(wasm);
  sender = new Sender(options);
  longest = options.analysisSide || longest;
  postMessage({ kind: "ready" });
}

function take({ picture, captureTime }) {
  const begun = performance.now();
  const { data, width, height } = pixels(picture);
  const sent = sender.push(data, width, height, captureTime);
  postMessage({ kind: "sent", sent, captureTime, milliseconds: performance.now() - begun });
}

onmessage = async ({ data }) => {
  try {
    if (data.kind === "start") await start(data);
    if (data.kind === "picture") take(data);
    if (data.kind === "key") sender.requestKey();
    if (data.kind === "finish") postMessage({ kind: "finished", sent: sender.finish() });
  } catch (error) {
    postMessage({ kind: "failed", message: error.message, of: data.kind });
  }
};
