// The page /selfcheck: shows what the browser and the device can do, and tells the bridge, which logs it.

import { CdrWriter } from "./cdr.js";
import { element, setText } from "./panels.js";
import { Connection } from "./transport.js";
import { FEATURES, XrSession, isMixedRealityOffered, requestSession } from "./xr_session.js";

/** The topic whose messages the bridge logs. */
export const TOPIC = "/mr_slam/selfcheck";
/** How long a session is observed, ms. */
const SESSION_MS = 3000;
/** Longest text that is sent, characters: the bridge cuts off the rest. */
const REPORT_MAX = 2000;

/** Facts in the order in which they were found. @type {Map<string, string>} */
const facts = new Map();

/** Shows a fact. @param {string} name @param {unknown} value */
function setFact(name, value) {
  const text = value === true ? "yes" : value === false ? "no" : String(value);
  let cell = document.querySelector(`[data-fact="${CSS.escape(name)}"]`);
  if (!cell) {
    const row = document.createElement("tr");
    const heading = document.createElement("th");
    heading.scope = "row";
    heading.textContent = name;
    cell = document.createElement("td");
    cell.setAttribute("data-fact", name);
    row.append(heading, cell);
    element("facts").append(row);
  }
  setText(cell, text);
  facts.set(name, text);
}

const live = new Connection(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/`, {
  message: () => {},
  state: (isOpen) => {
    setText(element("link"), isOpen ? "connected" : "no connection");
    if (isOpen) report();
  },
});

/** Tells the bridge all facts. */
function report() {
  const text = [...facts].map(([name, value]) => `${name}: ${value}`).join("; ").slice(0, REPORT_MAX);
  live.publish(TOPIC, "std_msgs/msg/String", new CdrWriter().string(text).done(), true);
}

/** Finds out what is known without a session. */
async function checkBrowser() {
  setFact("Browser", navigator.userAgent);
  setFact("Secure origin", window.isSecureContext);
  const gl = document.createElement("canvas").getContext("webgl2");
  setFact("WebGL 2", gl !== null);
  if (gl) setFact("Largest texture", `${gl.getParameter(gl.MAX_TEXTURE_SIZE)} pixels`);
  setFact("WebXR", "xr" in navigator);
  const isOffered = await isMixedRealityOffered();
  setFact("Mixed reality", isOffered);
  /** @type {HTMLButtonElement} */ (element("session")).disabled = !isOffered;
  report();
}

/** Begins a session, and finds out what the device gives in it. */
async function checkSession() {
  const session = await requestSession();
  const enabled = session.enabledFeatures;
  for (const feature of ["local-floor", ...FEATURES]) setFact(feature, enabled ? enabled.includes(feature) : "not told");
  setFact("Blending", session.environmentBlendMode);
  setFact("Persistent anchors", "restorePersistentAnchor" in session);
  for (const name of ["depthUsage", "depthDataFormat"]) {
    try {
      setFact(name, session[name] ?? "not told");
    } catch {
      setFact(name, "refused");
    }
  }
  let frames = 0;
  const begun = performance.now();
  /** @type {XrSession} */
  const xr = await XrSession.begin(session, {
    input: () => {},
    moved: () => {},
    update: (frame, viewer) => {
      frames += 1;
      setFact("Views", viewer.views.length);
      setFact("Planes", frame.detectedPlanes?.size ?? "none");
      setFact("Meshes", frame.detectedMeshes?.size ?? "none");
    },
    draw: () => {
      const { depth, viewport } = xr.renderer.eye ?? {};
      setFact("Pixels of a view", `${viewport?.width} × ${viewport?.height}`);
      setFact("Hides by", xr.occlusion);
      if (depth) setFact("Depth", `from ${depth.near} m, layer ${depth.layer}`);
      const inputs = [...session.inputSources].map((/** @type {any} */ source) => `${source.handedness} ${source.hand ? "hand" : "controller"}`);
      setFact("Inputs", inputs.join(", ") || "none");
    },
    ended: () => {
      setFact("Frames per second", (frames / ((performance.now() - begun) / 1000)).toFixed(0));
      report();
    },
    failed: (error) => setFact("Error", error.message),
  });
  setTimeout(() => xr.end(), SESSION_MS);
}

element("session").addEventListener("click", () => {
  checkSession().catch((error) => {
    setFact("Error", error.message);
    report();
  });
});
checkBrowser();
