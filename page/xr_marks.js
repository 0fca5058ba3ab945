// Marks of the map in mixed reality: the areas that robots are kept out of, and the places that exploration has left.

import { multiply, translation } from "./matrix.js";
import { VERTEX_NUMBERS, ribbon } from "./models.js";

/** @typedef {import("./renderer.js").Renderer} Renderer */
/** @typedef {import("./state.js").Fleet} Fleet */

/** Width of an area's border, and size of a place left, metres. */
const BORDER_M = 0.04;
const PLACE_M = 0.12;
/** Height above the floor, metres: over the map, under the robots. */
const HEIGHT_M = 0.01;
/** Red of the areas, and white of the places. @type {[number, number, number, number]} */
const AREA_COLOUR = [0.93, 0.26, 0.3, 0.9];
/** @type {[number, number, number, number]} */
const PLACE_COLOUR = [1, 1, 1, 0.9];

/** Returns the borders of areas as triangles: each side by itself, so that corners stay sharp. @param {import("./zones.js").Zone[]} zones */
export function bordersOf(zones) {
  const sides = zones.flatMap(({ corners }) => corners.map((corner, i) => ribbon([corner, corners[(i + 1) % corners.length]], BORDER_M).vertices));
  const vertices = new Float32Array(sides.reduce((sum, { length }) => sum + length, 0));
  let at = 0;
  for (const side of sides) {
    vertices.set(side, at);
    at += side.length;
  }
  return vertices;
}

/** Draws the marks. */
export class Marks {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
    this.borders = renderer.createMesh({ vertices: new Float32Array(0), count: 0 });
    this.places = renderer.createPlaces(new Float32Array(0));
    /** What is shown. @type {{zones: unknown, left: unknown}} */
    this.shown = { zones: null, left: null };
  }

  /** Takes what has changed. @param {Fleet} fleet */
  update({ zones, exploration }) {
    const left = exploration?.left ?? null;
    if (zones !== this.shown.zones) this.renderer.update(this.borders, bordersOf(zones), VERTEX_NUMBERS);
    if (left !== this.shown.left) this.renderer.update(this.places, new Float32Array((left ?? []).flatMap(({ x, y }) => [x, y, HEIGHT_M])), 3);
    this.shown = { zones, left };
  }

  /** @param {import("./matrix.js").Matrix} xrFromMap @param {number} scale of the map */
  draw(xrFromMap, scale) {
    const { renderer, borders, places } = this;
    if (borders.count > 0) renderer.drawMesh(borders, multiply(xrFromMap, translation(0, 0, HEIGHT_M)), AREA_COLOUR, { light: 0 });
    if (places.count > 0) renderer.drawPoints(places, xrFromMap, PLACE_COLOUR, PLACE_M * scale);
  }
}
