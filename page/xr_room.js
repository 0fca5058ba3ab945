// "Use my room": the headset's scan as a file of a room, offered to the laptop as the simulators' world.

import { translation } from "./matrix.js";
import { triangulate } from "./polygon.js";
import { MAP } from "./state.js";
import { KeptAnchor } from "./xr_anchors.js";

/** Triangles up to which a room is offered: the bridge takes 16 MB, and a scanned room has a tenth of that. */
const TRIANGLES_MAX = 300_000;
/** Corners of a box's triangles: what is more is a scan. */
const BOX_INDICES = 36;
const LEVEL = { x: 0, y: 0, z: 0, w: 1 };

/** @typedef {{label: string, position: any, orientation: any, vertices: Float32Array, indices: Uint32Array}} Part */

/**
 * Returns what a frame shows of the room: the scanned mesh, or the boxes of furniture and the planes of walls and floor.
 * @param {any} frame @param {any} space the floor's @returns {Part[]}
 */
export function partsOfRoom(frame, space) {
  const meshes = [...(frame.detectedMeshes ?? [])];
  const scans = meshes.filter((mesh) => mesh.indices.length > BOX_INDICES);
  const surfaces = scans.length > 0
    ? scans.map((mesh) => [mesh, mesh.meshSpace, mesh.vertices, mesh.indices])
    : [...meshes.map((mesh) => [mesh, mesh.meshSpace, mesh.vertices, mesh.indices]),
      ...[...(frame.detectedPlanes ?? [])].map((plane) => [plane, plane.planeSpace, ...surfaceOf(plane.polygon)])];
  return surfaces.flatMap(([surface, of, vertices, indices]) => {
    const pose = frame.getPose(of, space);
    if (!pose || indices.length === 0) return [];
    const { position, orientation } = pose.transform;
    const label = String(surface.semanticLabel ?? "unknown");
    return [{ label, position, orientation, vertices: new Float32Array(vertices), indices: new Uint32Array(indices) }];
  });
}

/** Returns corners and triangles of a polygon in the plane y = 0. @param {{x: number, z: number}[]} polygon @returns {[number[], number[]]} */
function surfaceOf(polygon) { return [[...polygon].flatMap(({ x, z }) => [x, 0, z]), triangulate([...polygon])]; }

/** Returns the file of a room: scene JSON, with y up and the floor at 0. Throws an Error that says why there is none. @param {Part[]} parts */
export function roomFile(parts) {
  if (parts.length === 0) throw new Error("the headset has no scan of this room: run Space Setup in its settings");
  const triangles = parts.reduce((sum, { indices }) => sum + indices.length / 3, 0);
  if (triangles > TRIANGLES_MAX) throw new Error(`the scan has ${triangles} triangles; at most ${TRIANGLES_MAX} can be sent`);
  const entities = parts.map(({ label, position, orientation, vertices, indices }, i) => ({
    uuid: `part ${i}`, semanticLabel_META: label, locatable_META: { position: xyz(position), orientation: { ...xyz(orientation), w: orientation.w } },
    triangleMesh_META: { vertices: base64(vertices), indices: base64(indices) },
  }));
  const floor = { uuid: "floor", semanticLabel_META: "FLOOR", locatable_META: { position: { x: 0, y: 0, z: 0 }, orientation: LEVEL } };
  return JSON.stringify({ type: "scene", version: 1, spatialEntities: [floor, ...entities] });
}

function xyz(/** @type {any} */ { x, y, z }) { return { x, y, z }; }

/** @param {Float32Array | Uint32Array} numbers little-endian, as on all devices with WebXR */
function base64(numbers) {
  const bytes = new Uint8Array(numbers.buffer, numbers.byteOffset, numbers.byteLength);
  let text = "";
  // An argument list has no place for a whole mesh.
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
}

/** Offers a room to the laptop; returns a text for the operator. @param {string} file @returns {Promise<{isOffered: boolean, text: string}>} */
export async function offerRoom(file) {
  try {
    const response = await fetch("/room", { method: "POST", headers: { "Content-Type": "application/json" }, body: file });
    const text = (await response.text()).trim();
    return response.ok ? { isOffered: true, text: "accept the room at the laptop: mr-slam room accept" } : { isOffered: false, text };
  } catch (error) {
    return { isOffered: false, text: `the room could not be sent: ${/** @type {Error} */ (error).message}` };
  }
}

/** The room's frame on the floor of WebXR, as `map` of the fleet that starts in the room: x to the right, y ahead. */
const MAP_IN_ROOM = { x: 0, y: 0, yaw: Math.PI / 2 };

/** Sends the room when the operator asks for it, and puts the map where the room is when the fleet has started in it. */
export class RoomSender {
  /** @param {(text: string) => void} show a text for the operator */
  constructor(show) {
    this.show = show;
    this.isAsked = false;
    /** Where the room was when it was sent, kept by the device. */
    this.anchor = new KeptAnchor("room");
    /** The number of the run in which the room was sent, until another one begins. @type {number | null} */
    this.sentIn = null;
  }

  /** Sends the room with the next frame. */
  ask() { this.isAsked = true; }

  /** @param {any} frame @param {any} space @param {number} runs number of the present run @param {import("./xr_alignment.js").Alignment} alignment */
  update(frame, space, runs, alignment) {
    if (this.isAsked) {
      this.isAsked = false;
      this.send(frame, space, runs);
    }
    if (this.sentIn === null || this.sentIn === runs) return;
    this.sentIn = null;
    const matrix = this.anchor.matrix(frame, space);
    if (matrix) alignment.put(frame, space, matrix, MAP, MAP_IN_ROOM);
    this.show("the robots are in your room");
  }

  /** @param {any} frame @param {any} space @param {number} runs */
  send(frame, space, runs) {
    let file;
    try {
      file = roomFile(partsOfRoom(frame, space));
    } catch (error) {
      this.show(/** @type {Error} */ (error).message);
      return;
    }
    this.anchor.put(frame, space, translation(0, 0, 0), null);
    this.show("sending the room");
    offerRoom(file).then(({ isOffered, text }) => {
      this.sentIn = isOffered ? runs : this.sentIn;
      this.show(text);
    });
  }
}
