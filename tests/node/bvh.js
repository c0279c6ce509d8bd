// Reads a BVH file with the loader of three.js and prints where its bones are.
// Usage: bvh.js FILE.bvh FRAME ...
// Prints one JSON object a frame: name of a bone (or ENDSITE) to a list of positions, in the order of the file.
import { readFileSync } from "node:fs";
import { AnimationMixer } from "three";
import { BVHLoader } from "three/addons/loaders/BVHLoader.js";

const [file, ...frames] = process.argv.slice(2);
const { skeleton, clip } = new BVHLoader().parse(readFileSync(file, "utf8"));
const mixer = new AnimationMixer(skeleton.bones[0]);
mixer.clipAction(clip).play();
const step = clip.duration / (clip.tracks[0].times.length - 1);
for (const frame of frames) {
  mixer.setTime(Number(frame) * step);
  skeleton.bones[0].updateMatrixWorld(true);
  const out = {};
  for (const bone of skeleton.bones) {
    const [x, y, z] = bone.matrixWorld.elements.slice(12, 15);
    (out[bone.name] ??= []).push([x, y, z]);
  }
  console.log(JSON.stringify(out));
}
