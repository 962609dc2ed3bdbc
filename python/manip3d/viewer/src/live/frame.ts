// Decoder of the frames of a live session; stream_frame.hpp describes their layout.

const MAGIC = 0x4c44334d; // "M3DL"
const VERSION = 1;
const HEADER_BYTES = 88;
const WIDE_INDICES = 1;
const SHARED_IMAGE = 2;

export interface GameStatus {
  name: string;
  difficulty: number;
  phase: "waiting" | "starting" | "playing" | "paused" | "over";
  left_s?: number;
  score?: number;
  misses?: number;
  by_phantom?: number;
  radius?: number;
  ceiling?: number;
  targets?: number[][]; // number, x, y, z
  stains?: number[][];
  keys?: number[][]; // places of the piano's keys, from the player's left
  up?: number; // number of the key that lights up; -1: none
  disks?: number[][]; // places of the disks over the pedals: left, right
  starts?: number[][];
  strokes?: number[];
  needed?: number;
  events?: (string | number)[][]; // kind, number, bone, x, y, z, key, a count of all events
  ending?: "time" | "misses" | "done" | "stopped";
  paused_s?: number;
  halt: string; // why no further game may start today; empty: games may start
  ask: string; // question that the patient must answer before a game starts
  pain: number | null; // last rating of the pain
  sitting: "open" | "ending" | "over"; // ending: waiting for the last rating
}

export interface TouchStatus {
  mode: "synchronous" | "asynchronous";
  left_s: number;
  place: number[] | null; // where the ball touches the limb now
  felt: boolean; // whether the therapist should touch the patient now
  due: [number, string] | null; // seconds to the next touch, and its joint
  ticks: number; // number of touches so far
}

export interface Status {
  state: string;
  reason: string;
  message: string;
  joints?: number[][];
  joint_states?: number[];
  down?: number[]; // vertical in the camera's frame; all places are in axes in which it is +y
  colliders?: number[][]; // start, end, radius of each bone
  torso?: { centre: number[]; axes: number[][]; half: number[] } | null;
  stage_ms?: Record<string, number>;
  affected?: string;
  gain?: number; // gain of virtual enhancement
  checks?: [string, boolean, string][]; // checks of the set-up: name, whether it is met, advice
  people?: [number, boolean][]; // people in view, from left to right: number, is it the patient
  calibrated?: number | null; // share of the calibration's duration that is over; 1: done
  clips?: boolean | null; // consent; null: there is no diary
  touch?: TouchStatus | null;
  felt_as?: Record<string, number> | null; // the patient's description of the limb as it is felt
  felt?: number[][] | null; // root, middle and end of the limb as it is felt
  game: GameStatus;
}

export interface Frame {
  sequence: number;
  capturedMs: number;
  numVertices: number;
  bodyFaces: number;
  phantomFaces: number;
  opacity: number;
  low: number[];
  step: number[];
  positions: Uint16Array;
  texcoords: Uint16Array;
  faces: Uint16Array | Uint32Array;
  bodyJpeg: Uint8Array;
  phantomJpeg: Uint8Array;
  sharesImage: boolean;
  status: Status;
}

/** Decodes a message; throws an Error that states what is wrong with it. */
export function readFrame(buffer: ArrayBuffer): Frame {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES) throw new Error("frame: too short");
  if (view.getUint32(0, true) !== MAGIC) throw new Error("frame: no frame of manip3d");
  if (view.getUint16(4, true) !== VERSION) throw new Error("frame: another version");
  if (view.getUint16(6, true) !== HEADER_BYTES) throw new Error("frame: another header");
  const flags = view.getUint32(12, true);
  const numVertices = view.getUint32(32, true);
  const bodyFaces = view.getUint32(36, true);
  const phantomFaces = view.getUint32(40, true);
  let at = HEADER_BYTES;
  const section = (bytes: number): number => {
    const start = Math.ceil(at / 4) * 4;
    at = start + bytes;
    if (at > buffer.byteLength) throw new Error("frame: shorter than its header says");
    return start;
  };
  const numIndices = 3 * (bodyFaces + phantomFaces);
  const positions = new Uint16Array(buffer, section(6 * numVertices), 3 * numVertices);
  const texcoords = new Uint16Array(buffer, section(4 * numVertices), 2 * numVertices);
  const wide = (flags & WIDE_INDICES) !== 0;
  const start = section((wide ? 4 : 2) * numIndices);
  const faces = wide
    ? new Uint32Array(buffer, start, numIndices)
    : new Uint16Array(buffer, start, numIndices);
  for (const index of faces) {
    if (index >= numVertices) throw new Error("frame: an index is out of range");
  }
  const bytes = (offset: number): Uint8Array => {
    const size = view.getUint32(offset, true);
    return new Uint8Array(buffer, section(size), size);
  };
  const bodyJpeg = bytes(72);
  const sharesImage = (flags & SHARED_IMAGE) !== 0;
  const phantomJpeg = sharesImage ? new Uint8Array() : bytes(76);
  const status = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes(80))) as Status;
  const floats = (offset: number): number[] =>
    [0, 4, 8].map((step) => view.getFloat32(offset + step, true));
  return {
    sequence: view.getUint32(8, true),
    capturedMs: Number(view.getBigInt64(24, true)) / 1e6,
    numVertices,
    bodyFaces,
    phantomFaces,
    opacity: view.getFloat32(44, true),
    low: floats(48),
    step: floats(60),
    positions,
    texcoords,
    faces,
    bodyJpeg,
    phantomJpeg,
    sharesImage,
    status,
  };
}
