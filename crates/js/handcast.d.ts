/** Which hand of the person. */
export type Side = "left" | "right";

/** A hand at an instant; its arrays have memory of their own. */
export interface Hand {
  side: Side;
  /** The pose is held or guessed: data were lost, or the sender saw no hand. */
  lost: boolean;
  /** How sure its maker was, 0 to 1, where that is known; of a held pose it falls to 0 within a second. */
  confidence: number | null;
  /** 29 joint angles in radians, in the order of `ANGLE_NAMES`. */
  angles: Float32Array;
  /** The wrist's matrix, column by column, metres: x to the right, y up, z towards the viewer. */
  wrist: Float32Array;
  /**
   * World matrices of 25 joints, 16 numbers each, column by column, in the order of `JOINT_NAMES`. Axes: y along the
   * bone, z out of the palm; `webxrMatrix` has those of WebXR.
   */
  joints: Float32Array;
}

/** What a stream says of an instant: one hand or two. */
export interface Frame {
  /** Seconds from the stream's start, or its time code. */
  time: number;
  hands: Hand[];
}

/** The sizes of a hand. */
export interface Sizes {
  /** All of them, metres: `handcast_web::sizes`. */
  numbers: Float64Array;
  /** From the wrist to the tip of the middle finger, metres. */
  handLength: number;
  /** Of the 25 joints, metres. */
  radii: Float32Array;
  /** How often a decoder has learned others: 0 while they are the mean hand's. */
  version: number;
}

/** What is known of a stream. */
export interface Facts {
  /** Frames per second. */
  rate: number;
  /** Nothing is to be believed before the next I plane. */
  lost: boolean;
  /** The stream's end has been seen. */
  ended: boolean;
  planes: number;
  intraPlanes: number;
  bits: number;
  /** How often damage was passed over, or suspected (`strict`). */
  damage: number;
  /** The tone of the skin, 1 (lightest) to 10, where the stream has told it. */
  skinTone: number | null;
}

export interface DecoderOptions {
  /**
   * Everything is given as it was sent, and damage throws: for files. Otherwise, for what comes live, damage is passed over:
   * hands keep their last pose, `lost`, up to the next I plane, and `facts.damage` counts it. Damage then is, too, where joints
   * are suddenly far outside their limits, and, in streams that were damaged before, poses beyond the limits and wrists that
   * leap; a clock that jumps by more than a minute is taken to go on.
   */
  strict?: boolean;
  /** The stream was made with the base steps of visage's encoder. */
  vendorSteps?: boolean;
  /** Poses get only the angles that were sent; the hand model adds none. */
  sentOnly?: boolean;
}

/** Bytes: a buffer, or what a view shows of one. */
export type Bytes = Uint8Array | ArrayBuffer | ArrayBufferView | SharedArrayBuffer;

/** Decodes one stream. Calls throw `HandcastError` where what they are given is none of what they take, and after `free()`. */
export interface Decoder {
  /**
   * Takes the next bytes, in pieces of any size and from any place of the stream on (poses begin at an I plane), and
   * gives the instants that are known now. Throws `HandcastError`; the next call then goes on at the next I plane and
   * gives what was known before.
   */
  push(bytes: Bytes): Frame[];
  /** As `push`, of bytes that end with a plane, as a room sends them: their instants do not wait for what follows. */
  pushPlane(bytes: Bytes): Frame[];
  /** Says that bytes were lost here: hands are `lost` up to the next I plane. */
  lose(): Frame[];
  /** Says that no more bytes come. Throws where none of the planes moved a hand. */
  finish(): Frame[];
  readonly facts: Facts;
  /** The sizes of a hand: those that the stream tells, the mean hand's before. */
  sizes(side: Side): Sizes;
  /** Gives a hand sizes until the stream tells others. */
  setSizes(side: Side, sizes: Sizes | ArrayLike<number>): void;
  /**
   * The hand of the decoder's sizes in a pose: 29 joint angles in radians, in the order of `ANGLE_NAMES`, the wrist's place
   * (metres) and its rotation (x, y, z, w).
   */
  pose(side: Side, angles: ArrayLike<number>, translation?: ArrayLike<number>, rotation?: ArrayLike<number>): Hand;
  /** Gives memory back at once; else it goes with the object. The decoder is of no use then. */
  free(): void;
}

/** The skin of a hand as WebGL takes it; names are those of the viewer page's data. */
export interface Surface {
  side: Side;
  /**
   * 32 bytes a vertex: position (4 shorts, normalised, of `cube`), normal (4 shorts, normalised), tint (3 bytes, shares
   * of 1.25), how little of it is palm (1 byte), joints (4 bytes), weights (4 unsigned shorts, normalised).
   */
  vertices: Uint8Array;
  triangles: Uint16Array | Uint32Array;
  /** Whether `triangles` are 32-bit numbers. */
  wide: boolean;
  parents: number[];
  /** Centre and half side of the cube that is ±1 in positions, metres. */
  cube: Float32Array;
  crease_width: number;
  creases: Float32Array;
  nails: Float32Array;
  lines: Float32Array;
  /** Place of each joint in the frame of its parent, 25 × 3, metres. */
  offsets: Float32Array;
  /** Rows of the matrix from the surface at rest to each joint's frame, 25 × 12. */
  inverse_bind: Float32Array;
}

/**
 * Where WebAssembly comes from; without one the file beside handcast.js. Relative addresses are the page's (in Node the working
 * folder's).
 */
export type Source = string | URL | Response | BufferSource | WebAssembly.Module | Promise<Response | BufferSource>;

export interface Handcast {
  Decoder: new (options?: DecoderOptions) => Decoder;
  /** The mean hand's sizes at a length of 0.05 to 0.4 m; 0.189 without one. */
  averageSizes(handLength?: number): Sizes;
  /** Red, green and blue (sRGB, 0 to 255) of skin of a tone of 1 (lightest) to 10 (darkest); `null` for `null`. */
  skinColour(tone: number | null): [number, number, number] | null;
  applyToXRHand: typeof applyToXRHand;
  skinningRows: typeof skinningRows;
  webxrMatrix: typeof webxrMatrix;
  JOINT_NAMES: string[];
  ANGLE_NAMES: string[];
  PARENTS: number[];
}

export class HandcastError extends Error {}

export const JOINT_NAMES: string[];
export const ANGLE_NAMES: string[];
/** Joint that carries each joint, -1 for the wrist. */
export const PARENTS: number[];

/** Loads the decoder: handcast_decoder.wasm. */
export function load(source?: Source): Promise<Handcast>;

/** Loads what makes the skin of a hand, for those who draw: handcast_surface.wasm. */
export function loadSurface(
  source?: Source,
): Promise<(side: Side, sizes: Sizes | ArrayLike<number>, options?: { fine?: boolean }) => Surface>;

/** Three rows of four numbers a joint, from the surface at rest to the world: what a skinning shader wants. */
export function skinningRows(joints: Float32Array, inverseBind: Float32Array, rows?: Float32Array): Float32Array;

/** The matrix of a joint with the axes of WebXR, column by column. */
export function webxrMatrix(joints: Float32Array, joint: number, out?: Float32Array): Float32Array;

/** An object of three.js, as `XRHandSpace` holds one for each joint. */
export interface JointObject {
  matrix: { fromArray(array: ArrayLike<number>): unknown; decompose(p: unknown, q: unknown, s: unknown): unknown };
  position: unknown;
  quaternion: unknown;
  scale: unknown;
  visible: boolean;
  matrixAutoUpdate: boolean;
  matrixWorldNeedsUpdate: boolean;
  jointRadius?: number;
}

/**
 * Poses a hand of WebXR as the browser would. `target` is what three.js's `renderer.xr.getHand()` gives, or any object
 * with `joints` by name; missing joints are made by `createJoint`. A function is told name, matrix (valid during the call)
 * and radius of each joint instead.
 */
export function applyToXRHand(
  target:
    | { joints: Record<string, any>; add?(joint: any): unknown }
    | ((name: string, matrix: Float32Array, radius?: number) => void),
  hand: Pick<Hand, "joints">,
  options?: { radii?: ArrayLike<number>; createJoint?: (name: string) => any },
): void;
