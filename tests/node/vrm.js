// Moves VRM avatars by VMC packets, as a receiver of them does, in three-vrm.
// Usage: vrm.js AVATAR.glb PACKETS.txt; a packet a line, in hex. Prints one JSON object: the version of VRM, and for each
// packet with bones the places in the world of the nodes of the hand ("LeftIndexProximal", …, "LeftIndexTip"), the avatar
// turned so that it faces +z.
import { readFileSync } from "node:fs";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { Vector3 } from "three";
import { VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";

/** The messages of an OSC bundle. */
function bundle(bytes) {
  const messages = [];
  if (bytes.toString("latin1", 0, 8) !== "#bundle\0") throw new Error("no bundle");
  for (let at = 16; at < bytes.length;) {
    const length = bytes.readUInt32BE(at);
    messages.push(message(bytes.subarray(at + 4, at + 4 + length)));
    at += 4 + length;
  }
  return messages;
}

function message(bytes) {
  let at = 0;
  const text = () => {
    const end = bytes.indexOf(0, at);
    const word = bytes.toString("utf8", at, end);
    at = (end + 4) & ~3;
    return word;
  };
  const address = text();
  const values = [...text().slice(1)].map(type => {
    if (type === "s") return text();
    at += 4;
    return type === "f" ? bytes.readFloatBE(at - 4) : bytes.readInt32BE(at - 4);
  });
  return { address, values };
}

const [file, packets] = process.argv.slice(2);
const loader = new GLTFLoader();
loader.register(parser => new VRMLoaderPlugin(parser));
const bytes = readFileSync(file);
const gltf = await loader.parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), "");
const vrm = gltf.userData.vrm;
const old = vrm.meta.metaVersion === "0";
VRMUtils.rotateVRM0(vrm);

/** The humanoid bone of a bone of Unity; their thumbs differ: three-vrm has the names of VRM 1.0. */
function bone(name) {
  const thumb = { Proximal: "Metacarpal", Intermediate: "Proximal" };
  const vrm1 = name.replace(/Thumb(Proximal|Intermediate)$/, (_, part) => `Thumb${thumb[part]}`);
  return vrm1[0].toLowerCase() + vrm1.slice(1);
}

const moments = [];
for (const line of readFileSync(packets, "utf8").split("\n").filter(Boolean)) {
  const bones = bundle(Buffer.from(line, "hex")).filter(m => m.address === "/VMC/Ext/Bone/Pos");
  if (!bones.length) continue;
  for (const { values: [name, , , , x, y, z, w] } of bones) {
    const node = vrm.humanoid.getNormalizedBoneNode(bone(name));
    if (!node) throw new Error(`no bone ${name}`);
    // Unity's axes are those of VRM 1.0 mirrored in x, those of VRM 0 mirrored in z.
    if (old) node.quaternion.set(-x, -y, z, w);
    else node.quaternion.set(x, -y, -z, w);
  }
  vrm.update(0);
  vrm.scene.updateMatrixWorld(true);
  const places = {};
  const note = (name, node) => { places[name] = node.getWorldPosition(new Vector3()).toArray(); };
  for (const { values: [name] } of bones) {
    const raw = vrm.humanoid.getRawBoneNode(bone(name));
    note(name, raw);
    if (name.endsWith("Distal")) note(name.replace("Distal", "Tip"), raw.children[0]);
  }
  moments.push(places);
}
console.log(JSON.stringify({ version: vrm.meta.metaVersion, moments }));
