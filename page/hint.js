// The hint above the map: why what the operator does has no effect, and what to do.

/** What the hint depends on. @typedef {object} HintSituation
 * @property {boolean} isReplay @property {boolean} isOpen whether there is a connection @property {boolean} isAnswering whether the bridge answers on it
 * @property {boolean} isStopUnconfirmed @property {boolean} isStopped
 * @property {boolean} mustSelect whether a robot must be selected first @property {boolean} isHeld whether a key or the stick is held
 * @property {string | null} otherDriver somebody else who drives the selected robot @property {boolean} mustLetGo whether what is held drives only after it was let go
 * @property {string} cursor what the cursor on the map says
 */

/** Returns the hint; empty without one. The first that holds counts. @param {HintSituation} of */
export function hintText(of) {
  if (of.isReplay && of.isOpen) return "Replay of a recording: nothing drives. The keys in its terminal pause it and change its speed.";
  if (!of.isOpen) return "No connection to the bridge: you drive nothing. Robots with goals drive on. Trying again …";
  if (!of.isAnswering) return "The bridge does not answer: you drive nothing, robots with goals drive on. What is shown is old.";
  if (of.isStopUnconfirmed) return "The emergency stop is not confirmed. It is sent again whenever the connection comes back.";
  if (of.isStopped) return "Emergency stop is set. Release it at the top to drive on.";
  if (of.mustSelect && of.isHeld) return "Select a robot first.";
  if (of.otherDriver && of.isHeld) return `${of.otherDriver} drives this robot. Press T to take it over.`;
  if (of.mustLetGo) return "Let go of the key, the stick or the grip, and hold it again to drive.";
  return of.cursor;
}
