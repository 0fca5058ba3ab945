// The form /tlx: six ratings of a person's workload, raw NASA-TLX (Hart and Staveland 1988), sent with POST /tlx.

/** Key, question, and what the ends mean. */
export const SCALES = [
  ["mental_demand", "How mentally demanding was the task?", "very low", "very high"],
  ["physical_demand", "How physically demanding was the task?", "very low", "very high"],
  ["temporal_demand", "How hurried or rushed was the pace of the task?", "very low", "very high"],
  ["performance", "How successful were you in accomplishing what you were asked to do?", "perfect", "failure"],
  ["effort", "How hard did you have to work to accomplish your level of performance?", "very low", "very high"],
  ["frustration", "How insecure, discouraged, irritated, stressed and annoyed were you?", "very low", "very high"],
];

/** Returns the text of the answer, or null while a rating is missing. @param {Map<string, number>} ratings */
export function answerText(ratings) {
  const missing = SCALES.some(([key]) => !ratings.has(key));
  return missing ? null : JSON.stringify(Object.fromEntries(SCALES.map(([key]) => [key, ratings.get(key)])));
}

/** Builds the form. A slider that nobody moved is no rating. */
function begin() {
  /** @type {Map<string, number>} */
  const ratings = new Map();
  const find = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
  const send = /** @type {HTMLButtonElement} */ (find("send"));
  const show = (/** @type {string} */ text) => { find("state").textContent = text; };
  for (const [key, question, low, high] of SCALES) {
    const row = document.createElement("tr");
    const [heading, cell] = [document.createElement("th"), document.createElement("td")];
    const slider = document.createElement("input");
    Object.assign(slider, { type: "range", min: "0", max: "100", step: "5", value: "50", id: key });
    slider.setAttribute("aria-label", `${question} ${low} to ${high}`);
    heading.scope = "row";
    heading.textContent = question;
    const value = document.createElement("output");
    value.textContent = "not rated";
    const rate = () => {
      ratings.set(key, Number(slider.value));
      value.textContent = slider.value;
      const missing = SCALES.length - ratings.size;
      show(missing ? `${missing} ratings are missing` : "complete");
      send.disabled = missing > 0;
    };
    for (const event of ["input", "change", "pointerup"]) slider.addEventListener(event, rate);
    const [left, right] = [low, high].map((text) => Object.assign(document.createElement("span"), { textContent: text }));
    cell.append(left, slider, right, value);
    row.append(heading, cell);
    find("scales").append(row);
  }
  find("form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const body = answerText(ratings);
    if (!body) return;
    send.disabled = true;
    try {
      const headers = { "Content-Type": "application/json" };
      const response = await fetch("tlx", { method: "POST", headers, body });
      show((await response.text()).trim());
      send.disabled = response.ok;
    } catch (error) {
      show(`not sent: ${error}`);
      send.disabled = false;
    }
  });
}

if (typeof document !== "undefined") begin();
