import type { Bytes, Frame, Side, Sizes, Source } from "./handcast.js";

/** Values that are not allowed throw `HandcastError`; a number that is 0 is the default. */
export interface SenderOptions {
  /** Frames per second of the stream: as many as will be pushed, 1/16 to 255; 30 without one. */
  rate?: number;
  /** Root mean square error of the angles that is aimed at, 0.01 to 180 degrees; 0.5 without one. */
  rms?: number;
  /** The hand, when only one is wanted. */
  side?: Side;
  /** Palm or back, when it is known. */
  view?: "palm" | "back";
  /** Pictures are mirrored, as a selfie view is; what a camera gives is not. */
  mirror?: boolean;
  /** Tracking starts from any posture, with the mean hand's sizes; otherwise from an open hand. */
  anyStart?: boolean;
  /** From the wrist to the tip of the middle finger, 0.05 to 0.4 m; 0.189 without one. */
  handLength?: number;
  /** Angle that the longer side of the picture sees, 5 to 150 degrees; 60 without one. */
  fieldOfView?: number;
  /** Longer side of the pictures that are looked at, 64 to 4096 pixels; 640 without one. Larger pictures are shrunk. */
  analysisSide?: number;
}

/** What a picture gave. */
export interface Sent {
  /** Bytes of the stream, a plane each: mostly one, none before a hand has been found or while nothing moves. */
  planes: Uint8Array[];
  /** Which of the planes a decoder can begin with. */
  keys: boolean[];
  /** The same as messages of a room (spec/live.md), with a hello before them when hands have come or gone. */
  messages: Uint8Array[];
  /** Poses that have become known: those of pictures that waited for the first open hand come with it. */
  poses: Frame[];
  /** Why nothing was found in the pictures so far, where looking begins anew. */
  trouble: string | null;
}

/** Tracks hands and makes planes of their poses, on the thread that calls. */
export interface Sender {
  /**
   * Takes a picture of four bytes a pixel, captured at so many milliseconds (of the room's clock), later than the one
   * before. Throws `HandcastError`.
   */
  push(rgba: Bytes, width: number, height: number, captureTime: number): Sent;
  /** Makes the next plane one that a decoder can begin with. */
  requestKey(): void;
  /** Ends the stream: its last planes. */
  finish(): Sent;
  /** The sizes of a hand that has been found. */
  sizes(side: Side): Sizes | null;
  /** The tone of the skin, 1 (lightest) to 10, once a hand has been sure. */
  readonly skinTone: number | null;
  /** Gives memory back at once; other calls throw then. */
  free(): void;
}

/** Loads tracker and encoder: handcast_sender.wasm. */
export function loadSender(source?: Source): Promise<{ Sender: new (options?: SenderOptions) => Sender }>;

/** A sender in a worker of its own. Pictures are dropped while it is busy, never queued. */
export class SenderWorker {
  constructor(
    options?: SenderOptions,
    means?: {
      /** What each picture gave, when it was captured, and what it took. */
      onsent?(sent: Sent, of: { captureTime: number; milliseconds: number }): void;
      /** Why nothing was made of a picture; without one it is told on the console. */
      onerror?(error: Error): void;
      /** The module, its bytes or its address (as the page has it); without, the file beside the worker. */
      wasm?: string | URL | BufferSource | WebAssembly.Module;
      /** Another worker than sender-worker.js beside this file, which does the same. */
      worker?: Worker;
    },
  );
  /** When the module has been loaded; rejects, and ends the worker, where it cannot be. */
  readonly ready: Promise<void>;
  /** Whether a picture would be dropped: before `ready`, while one is looked at, after `finish()`. */
  readonly busy: boolean;
  /**
   * Takes a picture, which goes to the worker, captured at so many milliseconds; false where it was dropped. Throws where it
   * cannot go to a worker: it is closed, or no picture.
   */
  push(picture: VideoFrame | ImageBitmap | ImageData, captureTime: number): boolean;
  /** Makes the next plane one that a decoder can begin with; before `ready`, too. */
  requestKey(): void;
  /** Ends the stream, once the worker is ready, and the worker: its last planes. Called again it gives the same promise. */
  finish(): Promise<Sent>;
}
