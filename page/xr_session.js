// A session of mixed reality (WebXR, immersive-ar): its frames, views, the device's depth, and the scanned room.

import { Renderer } from "./renderer.js";

/** @typedef {import("./renderer.js").Eye} Eye */
/** @typedef {import("./renderer.js").Depth} Depth */
/** @typedef {import("./renderer.js").Drawable} Drawable */

/** What is used where the device has it. None of it is required but the floor. */
export const FEATURES = ["anchors", "hit-test", "hand-tracking", "mesh-detection", "plane-detection", "depth-sensing"];
/** Corners of a box's triangles. The scan of a whole room has more; then boxes around its furniture would hide too much. */
const BOX_INDICES = 36;

/** Returns whether this browser offers mixed reality here. */
export async function isMixedRealityOffered() {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-ar")) ?? false;
  } catch {
    return false;
  }
}

/** Asks for a session. Browsers allow it only after a click. @returns {Promise<any>} */
export function requestSession() {
  const depthSensing = { usagePreference: ["gpu-optimized"], dataFormatPreference: ["float32", "luminance-alpha", "unsigned-short"] };
  return /** @type {any} */ (navigator).xr.requestSession("immersive-ar", {
    requiredFeatures: ["local-floor"], optionalFeatures: FEATURES, depthSensing,
  });
}

/** Hides what is behind the scanned room, where the device gives its mesh and no depth. */
class RoomMesh {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
    /** @type {Map<any, {changedAt: number, drawable: Drawable}>} */
    this.parts = new Map();
  }

  /** Takes the meshes of a frame. @param {any} frame */
  update(frame) {
    const meshes = [...(frame.detectedMeshes ?? [])];
    for (const [mesh, { drawable }] of this.parts) {
      if (meshes.includes(mesh)) continue;
      this.renderer.delete(drawable);
      this.parts.delete(mesh);
    }
    for (const mesh of meshes) {
      const known = this.parts.get(mesh);
      if (known?.changedAt === mesh.lastChangedTime) continue;
      if (known) this.renderer.delete(known.drawable);
      const drawable = this.renderer.createPlaces(mesh.vertices, new Uint32Array(mesh.indices));
      this.parts.set(mesh, { changedAt: mesh.lastChangedTime, drawable });
    }
  }

  /** @param {any} frame @param {any} space */
  draw(frame, space) {
    const hasScan = [...this.parts.values()].some(({ drawable }) => drawable.count > BOX_INDICES);
    for (const [mesh, { drawable }] of this.parts) {
      if (hasScan && drawable.count <= BOX_INDICES) continue;
      const pose = frame.getPose(mesh.meshSpace, space);
      if (pose) this.renderer.drawRoom(drawable, pose.transform.matrix);
    }
  }
}

/**
 * @typedef {object} Handlers
 * @property {() => void} moved the floor has other coordinates
 * @property {() => void} input at the beginning of each frame, wherever the headset is
 * @property {(frame: any, viewer: any) => void} update before the views of a frame
 * @property {() => void} draw one view, which the renderer has begun
 * @property {() => void} ended @property {(error: Error) => void} failed
 */

/** One session: calls back for each frame and view. */
export class XrSession {
  /** @param {any} session @param {any} space the floor's @param {Renderer} renderer @param {Handlers} handlers */
  constructor(session, space, renderer, handlers) {
    this.session = session;
    this.space = space;
    this.renderer = renderer;
    this.handlers = handlers;
    this.room = new RoomMesh(renderer);
    /** What hides things in this frame. @type {"depth" | "mesh" | "nothing"} */
    this.occlusion = "nothing";
    /** Whether the real room may hide things. */
    this.isHiding = true;
    const hasDepth = session.enabledFeatures?.includes("depth-sensing") ?? true;
    const Binding = /** @type {any} */ (globalThis).XRWebGLBinding;
    this.binding = hasDepth && Binding ? new Binding(session, renderer.gl) : null;
    session.addEventListener("end", () => {
      handlers.ended();
      renderer.dispose();
    });
    space.addEventListener?.("reset", handlers.moved);
    renderer.gl.canvas.addEventListener("webglcontextlost", () => this.end());
    session.requestAnimationFrame(this.frame);
  }

  /** Begins the frames of a session. @param {any} session @param {Handlers} handlers */
  static async begin(session, handlers) {
    const canvas = document.createElement("canvas");
    const options = { xrCompatible: true, alpha: true, antialias: true };
    const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", options));
    if (!gl) throw new Error("this browser has no WebGL 2");
    const XRWebGLLayer = /** @type {any} */ (globalThis).XRWebGLLayer;
    session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl), depthNear: 0.1, depthFar: 100 });
    const space = await session.requestReferenceSpace("local-floor");
    return new XrSession(session, space, new Renderer(gl), handlers);
  }

  /** Ends the session, if it has not ended. */
  end() { this.session.end().catch(() => {}); }

  /** @param {number} _time @param {any} frame */
  frame = (_time, frame) => {
    this.session.requestAnimationFrame(this.frame);
    try {
      this.drawFrame(frame);
    } catch (error) {
      this.handlers.failed(/** @type {Error} */ (error));
      this.end();
    }
  };

  /** @param {any} frame */
  drawFrame(frame) {
    this.handlers.input();
    const viewer = frame.getViewerPose(this.space);
    const layer = this.session.renderState.baseLayer;
    this.renderer.begin(layer.framebuffer);
    // While the device does not know where it is, nothing is drawn at a wrong place.
    if (!viewer) return;
    this.handlers.update(frame, viewer);
    const eyes = viewer.views.map((/** @type {any} */ view) => this.eyeOf(view, layer.getViewport(view)));
    const seeing = eyes.filter((/** @type {Eye | null} */ eye) => eye !== null);
    const hasDepth = seeing.some((/** @type {Eye} */ eye) => eye.depth !== null);
    if (!hasDepth) this.room.update(frame);
    this.occlusion = !this.isHiding ? "nothing" : hasDepth ? "depth" : this.room.parts.size > 0 ? "mesh" : "nothing";
    if (!this.isHiding) seeing.forEach((/** @type {Eye} */ eye) => { eye.depth = null; });
    for (const eye of seeing) {
      this.renderer.beginView(eye);
      if (this.occlusion === "mesh") this.room.draw(frame, this.space);
      this.handlers.draw();
    }
  }

  /** @param {any} view @param {any} viewport @returns {Eye | null} null if the view is not on the screen */
  eyeOf(view, viewport) {
    if (!viewport || viewport.width === 0) return null;
    const { x, y, z } = view.transform.position;
    return { view: view.transform.inverse.matrix, projection: view.projectionMatrix, viewport, place: [x, y, z], depth: this.depthOf(view) };
  }

  /** Returns the device's depth of a view, if it gives one now. @param {any} view @returns {Depth | null} */
  depthOf(view) {
    let info;
    try {
      info = this.binding?.getDepthInformation(view);
    } catch {
      // The device offers depth on the processor only, or has not allowed it.
      this.binding = null;
    }
    if (!info?.texture || info.textureType === "texture") return null;
    const far = Number.isFinite(info.depthFar) ? info.depthFar : 0;
    return {
      texture: info.texture, layer: info.imageIndex ?? 0, depthFromView: info.normDepthBufferFromNormView.matrix,
      near: info.depthNear ?? 0, far: far ?? 0, metresOfRaw: info.rawValueToMeters,
    };
  }
}
