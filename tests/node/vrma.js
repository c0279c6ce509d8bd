// Plays .vrma files on VRM avatars, as three-vrm does it.
// Usage: vrma.js AVATAR.glb ANIMATION.vrma SIDES TIME...; SIDES is left, right or both joined by a comma.
// Prints one JSON object: the version of VRM, length and tracks of the clip, and for each time the places in the world of the nodes
// of the hands ("LeftIndexProximal", …, "LeftIndexTip"), named as VMC names them, the avatar turned so that it faces +z.
import { readFileSync } from "node:fs";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { AnimationMixer, Vector3 } from "three";
import { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";
import { VRMAnimationLoaderPlugin, VRMLookAtQuaternionProxy, createVRMAnimationClip } from "@pixiv/three-vrm-animation";

const [avatar, animation, sides, ...times] = process.argv.slice(2);
const loader = new GLTFLoader();
loader.register(parser => new VRMLoaderPlugin(parser));
loader.register(parser => new VRMAnimationLoaderPlugin(parser));
const load = async file => {
  const bytes = readFileSync(file);
  return loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), "");
};
// What is said of the animation; the avatars are made for tests, and lack much.
let messages = [];
for (const kind of ["warn", "error"]) console[kind] = (...words) => messages.push(words.join(" "));

const vrm = (await load(avatar)).userData.vrm;
VRMUtils.rotateVRM0(vrm);
if (vrm.lookAt) vrm.scene.add(Object.assign(new VRMLookAtQuaternionProxy(vrm.lookAt), { name: "lookAtQuaternionProxy" }));
messages = [];
const found = (await load(animation)).userData.vrmAnimations;
if (found?.length !== 1) throw new Error(`${found?.length} animations`);
const clip = createVRMAnimationClip(found[0], vrm);
const mixer = new AnimationMixer(vrm.scene);
mixer.clipAction(clip).play();

const parts = { Thumb: ["Metacarpal", "Proximal", "Distal"], other: ["Proximal", "Intermediate", "Distal"] };
const moments = times.map(Number).map(time => {
  // The very end is the beginning of the next round.
  mixer.setTime(Math.min(time, clip.duration - 1e-6));
  vrm.update(0);
  vrm.scene.updateMatrixWorld(true);
  const places = {};
  const note = (name, node) => { places[name] = node.getWorldPosition(new Vector3()).toArray(); };
  for (const side of sides.split(",")) {
    const word = side[0].toUpperCase() + side.slice(1);
    note(`${word}Hand`, vrm.humanoid.getRawBoneNode(`${side}Hand`));
    for (const finger of ["Thumb", "Index", "Middle", "Ring", "Little"]) {
      (parts[finger] ?? parts.other).forEach((part, k) => {
        const node = vrm.humanoid.getRawBoneNode(`${side}${finger}${part}`);
        note(`${word}${finger}${parts.other[k]}`, node);
        if (part === "Distal") note(`${word}${finger}Tip`, node.children[0]);
      });
    }
  }
  return places;
});
const tracks = clip.tracks.map(track => track.name.split(".").at(-1));
console.log(JSON.stringify({ version: vrm.meta.metaVersion, duration: clip.duration, tracks, messages, moments }));
