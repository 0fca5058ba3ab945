// Pointers on the map: they move the view, draw goals and zones, measure, and select robots.

/** Movement up to which a press is a click, pixels. */
const CLICK_PX = 6;

/**
 * Listens to the pointers and the wheel on the map.
 * @param {object} of
 * @param {import("./view.js").View} of.view
 * @param {import("./state.js").Fleet} of.fleet
 * @param {import("./goals.js").GoalTool} of.goals
 * @param {import("./measure.js").MeasureTool} of.measure
 * @param {import("./zones.js").ZoneTool} of.zones
 * @param {(robot: number) => void} of.select
 * @param {(factor: number, pixel: {x: number, y: number}) => void} of.zoom
 * @param {() => void} of.show the view has changed
 */
export function attachPointers({ view, fleet, goals, measure, zones, select, zoom, show }) {
  const { canvas, camera } = view;
  /** Where the pointers are, pixels. @type {Map<number, {x: number, y: number, moved: number}>} */
  const pointers = new Map();
  const pixelOf = (/** @type {MouseEvent} */ event) => ({ x: event.offsetX, y: event.offsetY });

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { ...pixelOf(event), moved: 0 });
    const at = camera.toWorld(pixelOf(event));
    if (!measure.press(at) && !zones.press(at)) goals.press(at);
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const pixel = pixelOf(event);
    const [dx, dy] = [pixel.x - pointer.x, pixel.y - pointer.y];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      goals.cancelDrawing();
      measure.release();
      zones.cancel();
    }
    if (measure.isHeld) {
      measure.move(camera.toWorld(pixel));
    } else if (zones.isHeld) {
      zones.move(camera.toWorld(pixel));
    } else if (goals.drawn) {
      const start = camera.toScreen(goals.drawn.from);
      goals.move(camera.toWorld(pixel), Math.hypot(pixel.x - start.x, pixel.y - start.y));
    } else if (other) {
      const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
      const after = Math.hypot(pixel.x - other.x, pixel.y - other.y);
      if (before > 0) zoom(after / before, other);
    } else if (pointer.moved + Math.hypot(dx, dy) > CLICK_PX) {
      view.fits = false;
      view.followed = null;
      camera.pan(dx, dy);
      show();
    }
    pointers.set(event.pointerId, { ...pixel, moved: pointer.moved + Math.hypot(dx, dy) });
  });
  canvas.addEventListener("pointerup", (event) => {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    if (measure.isHeld) {
      measure.release();
    } else if (zones.isHeld) {
      zones.release();
    } else if (goals.drawn) {
      goals.release();
    } else if (pointer && pointer.moved <= CLICK_PX) {
      const number = view.robotAt(fleet, pointer);
      if (number !== null) select(number);
    }
  });
  canvas.addEventListener("pointercancel", (event) => {
    pointers.delete(event.pointerId);
    goals.cancelDrawing();
    measure.release();
    zones.cancel();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015), pixelOf(event));
  }, { passive: false });
}
