// Files that are dropped on the page or chosen: streams, and poses as JSON.

// As many as a page of the program holds.
const MOST_INSTANTS = 110000;
const MOST_BYTES = 64 << 20;
const NEITHER = "it is neither a stream (.fba) nor poses (.jsonl, .json), and nothing else is opened here";
// Seconds between instants that are one.
const SAME = 1e-6;

// Poses of both hands, [time, side, valid, row], as a motion; a row is what the decoder gives of a hand.
async function motionOf(title, rate, poses, sizesOf, more) {
  poses.sort((a, b) => a.time - b.time);
  const instants = [];
  for (const { time } of poses) if (!instants.length || time - instants.at(-1) >= SAME) instants.push(time);
  if (!instants.length) throw new Error("there is no pose in it");
  if (instants.length > MOST_INSTANTS) throw new Error(`${instants.length} instants, at most ${MOST_INSTANTS} are shown`);
  const found = [];
  for (const side of ["left", "right"]) {
    const own = poses.filter(pose => pose.side === side);
    if (!own.some(pose => pose.valid)) continue;
    const hand = {
      ...(await surfaces())(side, sizesOf(side)),
      frames: new Float32Array(instants.length * 300),
      valid: new Uint8Array(instants.length),
      angles: new Int16Array(instants.length * 29),
    };
    const [first, last] = [own[0].time, own.at(-1).time];
    let at = 0;
    // Where it is lost, the last pose is held, or the first.
    let held = own.find(pose => pose.valid);
    for (let i = 0; i < instants.length; i += 1) {
      // Hands may have times of their own: the last pose there was is shown, and counts between the first and the last.
      while (at + 1 < own.length && own[at + 1].time < instants[i] + SAME) {
        at += 1;
        if (own[at].valid) held = own[at];
      }
      const inside = instants[i] > first - SAME && instants[i] < last + SAME;
      hand.valid[i] = own[at].valid && inside ? 1 : 0;
      for (let k = 0; k < 29; k += 1) hand.angles[i * 29 + k] = Math.round(held.angles[k] * (18000 / Math.PI));
      for (let j = 0; j < 25; j += 1) {
        for (let r = 0; r < 3; r += 1) {
          for (let c = 0; c < 4; c += 1) hand.frames[i * 300 + j * 12 + r * 4 + c] = held.joints[j * 16 + c * 4 + r];
        }
      }
    }
    found.push(hand);
  }
  if (!found.length) throw new Error("there is no pose in it that counts");
  return { title, rate, times: Float64Array.from(instants), hands: found, stream: null, video: null, notes: [], ...more };
}

async function fromStream(title, content, strict = true) {
  const api = await decoding();
  const decoder = new api.Decoder({ strict });
  try {
    let frames;
    try {
      frames = [...decoder.push(content), ...decoder.finish()];
    } catch (error) {
      // Sound files are shown as they are, of damaged ones what is left.
      if (strict) return await fromStream(title, content, false);
      throw [0, 0, 1, 0xba].every((byte, i) => content[i] === byte) ? error : new Error(NEITHER);
    }
    const poses = frames.flatMap(({ time, hands }) => hands.map(hand => ({ ...hand, time, valid: !hand.lost })));
    const { rate, damage, skinTone } = decoder.facts;
    const notes = damage ? [`${damage} ${damage === 1 ? "place is" : "places are"} damaged`] : [];
    return await motionOf(title, rate, poses, side => decoder.sizes(side), { notes, skin: api.skinColour(skinTone), stream: { bytes: content.length } });
  } finally {
    decoder.free();
  }
}

// Sizes as a person file has them, in the order of the modules.
function sizesIn(told) {
  const list = [told.hand_length, told.palm_radius, told.wrist_half_width, ...told.webs];
  list.push(told.web_root ?? 0, told.ulnar_border ?? 0, told.wrist_lateral ?? 0, told.forearm ?? 1);
  for (const name of ["thumb", "index", "middle", "ring", "pinky"]) {
    const { metacarpal, base, bones, radii, waists = [1, 1, 1], lateral = [0, 0, 0, 0, 0, 0, 0] } = told.fingers[name];
    list.push(...metacarpal, ...base, ...bones, ...radii, ...waists, ...lateral);
  }
  return Float64Array.from(list);
}

async function fromPoses(title, text) {
  const whole = text.trimStart().split("\n").filter(line => line.trim());
  const parsed = (() => {
    try { return JSON.parse(text); } catch { return null; }
  })();
  const header = parsed ?? (() => {
    try { return JSON.parse(whole[0]); } catch { return {}; }
  })();
  if (header.format !== "handcast-poses") throw new Error(NEITHER);
  const lines = header.frames ?? whole.slice(1).map((line, i) => {
    try { return JSON.parse(line); } catch (error) { throw new Error(`line ${i + 2}: ${error.message}`); }
  });
  const api = await decoding();
  const decoder = new api.Decoder();
  try {
    for (const { side, morphology } of header.hands ?? []) if (morphology) decoder.setSizes(side, sizesIn(morphology));
    const poses = lines.map(line => {
      const angles = api.ANGLE_NAMES.map(name => (line.angles?.[name] ?? 0) * (Math.PI / 180));
      const { translation = [0, 0, 0], rotation = [0, 0, 0, 1] } = line.wrist ?? {};
      const { joints } = decoder.pose(line.hand, angles, translation, rotation);
      return { time: line.t, side: line.hand, valid: line.valid !== false && Boolean(line.wrist), angles, joints };
    });
    const sizes = { left: decoder.sizes("left"), right: decoder.sizes("right") };
    return await motionOf(title, header.rate ?? null, poses, side => sizes[side], { skin: api.skinColour(header.skin_tone) });
  } finally {
    decoder.free();
  }
}

// The motion in a file, told by its content.
async function fromFile(file) {
  if (file.size > MOST_BYTES) throw new Error(`${file.size} bytes, at most ${MOST_BYTES} are read`);
  const content = new Uint8Array(await file.arrayBuffer());
  if (!content.length) throw new Error("it is empty");
  const first = content.find(byte => ![32, 9, 10, 13].includes(byte));
  if (first === 0x7b) return fromPoses(file.name, new TextDecoder().decode(content));
  return fromStream(file.name, content);
}
