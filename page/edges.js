// Merge edges: how the robots' maps lie to each other, with the evidence. The operator can pin an edge or undo it.

import { CdrWriter } from "./cdr.js";
import { format, percent } from "./format.js";
import { readString } from "./messages.js";

/**
 * One pair of robots, as `/merge_edges` has it.
 * @typedef {object} Edge
 * @property {string} a @property {string} b names of the robots @property {string} state
 * @property {number | null} occupied_f1 agreement of walls, 0 to 1; of an edge that was not measured null, as the next ones
 * @property {number | null} null_f1_max the same by chance @property {number | null} overlap_m2 @property {number | null} residual_m @property {number} closures @property {number} closures_rejected
 * @property {number} compared_submaps @property {number} contradicted_submaps
 * @property {boolean} contradicted whether these are so many that one of the two maps is deformed, or lies wrong
 */

/** States in which an edge joins two maps. */
const JOINED = ["accepted", "pinned"];
/** What the states say to the operator. @type {Record<string, string>} */
const STATES = {
  candidate: "aligned once, a second alignment is needed", accepted: "joined", pinned: "joined, pinned by you", undone: "undone by you",
  dropped: "dropped, later maps contradict it",
};

/** Reads `/merge_edges`, a std_msgs/String with JSON: the edges, names of the robots whose given start the maps contradict, and whether they are not saved. @returns {{edges: Edge[], starts: string[], unsaved: boolean}} */
export function readEdges(/** @type {DataView} */ view) {
  let json;
  try {
    json = JSON.parse(readString(view));
  } catch {
    throw new RangeError("the merge edges are not JSON");
  }
  if (!Array.isArray(json?.edges)) throw new RangeError("the merge edges have no list");
  const starts = Array.isArray(json.contradicted_starts) ? json.contradicted_starts.filter(isText) : [];
  return { edges: json.edges.filter(isEdge), starts, unsaved: json.unsaved === true };
}

function isText(/** @type {unknown} */ value) { return typeof value === "string"; }

/** Returns whether this is an edge: of two robots, and in a state. @param {any} edge */
function isEdge(edge) { return [edge?.a, edge?.b, edge?.state].every(isText); }

/** Returns the number at the end of a robot's name; 0 if there is none. */
export function numberOf(/** @type {string} */ name) { return Number(/\d+$/.exec(name)?.[0] ?? 0); }

/** Returns the numbers of an edge's robots. @param {Edge} edge */
export function robotsOf({ a, b }) { return [a, b].map(numberOf); }

/** Returns an edge's state and evidence: two short texts. @param {Edge} edge */
export function describeEdge(edge) {
  const evidence = [
    `walls agree ${percent(edge.occupied_f1)}, by chance ${percent(edge.null_f1_max)}`,
    `${format(edge.overlap_m2, 1, " m²")} shared`,
    `${format(edge.residual_m === null ? null : edge.residual_m * 1000, 0, " mm")} apart`,
    `${format(edge.closures)} closures${edge.closures_rejected > 0 ? `, ${edge.closures_rejected} rejected` : ""}`,
  ];
  return { state: STATES[edge.state] ?? edge.state, evidence: evidence.join(" · ") };
}

/** Returns the commands that an edge allows. @param {Edge} edge @returns {("pin" | "unpin" | "undo")[]} */
export function commandsOf({ state }) {
  if (state === "pinned") return ["unpin", "undo"];
  return JOINED.includes(state) ? ["pin", "undo"] : [];
}

/** Names of the commands on buttons. */
export const COMMAND_NAMES = { pin: "Pin", unpin: "Unpin", undo: "Undo" };

/** Writes a command about an edge, a std_msgs/String. @param {"pin" | "unpin" | "undo"} command @param {Edge} edge */
export function writeEdgeCommand(command, edge) { return new CdrWriter().string(`${command} ${robotsOf(edge).join(" ")}`).done(); }

/** The panel of the edges: each with its evidence, and buttons that pin or undo it. */
export class EdgePanel {
  /** @param {HTMLElement} list @param {HTMLElement} section @param {(command: "pin" | "unpin" | "undo", edge: Edge) => void} onCommand */
  constructor(list, section, onCommand) {
    this.list = list;
    this.section = section;
    this.onCommand = onCommand;
    this.shown = "";
  }

  /** @param {Edge[]} edges */
  update(edges) {
    const found = edges.filter(({ state }) => state !== "none");
    this.section.hidden = found.length === 0;
    const shown = JSON.stringify(found.map((edge) => [edge.a, edge.b, describeEdge(edge)]));
    if (shown === this.shown) return;
    this.shown = shown;
    const focused = this.list.contains(document.activeElement) ? document.activeElement?.id : undefined;
    this.list.replaceChildren(...found.map((edge) => this.row(edge)));
    if (focused && !document.getElementById(focused)) this.list.querySelector("button")?.focus();
    else if (focused) document.getElementById(focused)?.focus();
  }

  /** @param {Edge} edge */
  row(edge) {
    const { state, evidence } = describeEdge(edge);
    const [first, second] = robotsOf(edge);
    const row = document.createElement("li");
    const title = document.createElement("p");
    const figures = document.createElement("p");
    title.textContent = `${first} – ${second}: ${state}`;
    figures.textContent = evidence;
    figures.className = "evidence";
    row.append(title, figures);
    for (const command of commandsOf(edge)) {
      const button = document.createElement("button");
      button.type = "button";
      button.id = `${command}-${first}-${second}`;
      button.textContent = COMMAND_NAMES[command];
      button.setAttribute("aria-label", `${COMMAND_NAMES[command]}: edge of robots ${first} and ${second}`);
      button.addEventListener("click", () => this.onCommand(command, edge));
      row.append(button);
    }
    return row;
  }
}
