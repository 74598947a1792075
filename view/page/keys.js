// Every key of the page, once: what it is called, what it does. The help panel lists this table.
//
// Keys that f3d has too mean the same here, where the two have the same thing. W, A, S, D, Q and E fly: input.js holds
// them down.

/** [keys as event.key has them, with "Ctrl+" and "Shift+" before; what the help says; name of the action]. */
export const KEYS = [
  ["Views", [
    [["r", "Enter", "Home"], "The first view", "reset"],
    [["1"], "From the front", "front"],
    [["3"], "From the right", "right"],
    [["7"], "From above", "top"],
    [["9"], "From a corner", "isometric"],
    [["4"], "Roll to the left by 90°", "roll_left"],
    [["6"], "Roll to the right by 90°", "roll_right"],
    [["c"], "Next camera of the scene", "next_camera"],
    [["Backspace", "Ctrl+z"], "The view before", "undo"],
    [["Shift+Backspace", "Ctrl+Shift+Z", "Ctrl+y"], "The view after", "redo"],
    [["b"], "Keep this view as a bookmark", "bookmark"],
    [["f"], "Turn about what the pointer is on", "focus"],
    [["+", "="], "Nearer", "nearer"],
    [["-"], "Farther", "farther"],
    [["ArrowLeft"], "Turn to the left", "turn_left"],
    [["ArrowRight"], "Turn to the right", "turn_right"],
    [["ArrowUp"], "Turn upwards", "turn_up"],
    [["ArrowDown"], "Turn downwards", "turn_down"],
  ]],
  ["Tools", [
    [["p"], "Pick the surface under the pointer", "pick"],
    [["m"], "Measure between two points", "measure"],
    [["Delete"], "Hide the material under the pointer", "hide"],
    [["l"], "All lamps a tenth stronger", "brighter"],
    [["Shift+L"], "All lamps a tenth weaker", "darker"],
    [["o"], "Light handles on or off", "handles"],
    [["v"], "Voxels, pages, or the picture", "debug"],
    [["F12", "Shift+S"], "Save a picture of this view", "screenshot"],
    [["Ctrl+c"], "Copy the link to this view", "copy_link"],
  ]],
  ["Page", [
    [["z"], "Statistics", "statistics"],
    [["n"], "All but the picture on or off", "bare"],
    [["?", "h"], "This help", "help"],
    [["Escape"], "Close, or end what is under way", "escape"],
  ]],
];

/** What is done by hand, for the help. */
export const HANDS = [
  ["Drag", "Turn about the target"],
  ["Right or Shift + drag", "Shift the view; the middle button, too"],
  ["Wheel", "Nearer and farther, towards the pointer"],
  ["W A S D, Q E", "Fly ahead, left, back, right, down, up; a drag looks around"],
  ["Shift + wheel", "Speed of flying"],
  ["Ctrl + click", "Pick a surface"],
  ["Double click", "Turn about this point"],
  ["One finger", "Turn"],
  ["Two fingers", "Shift and come nearer"],
];

/** The name of an action by key. */
const ACTIONS = new Map(
  KEYS.flatMap(([, rows]) => rows.flatMap(([keys, , action]) => keys.map((key) => [key, action]))),
);

/** The action that a key event stands for; undefined when there is none. */
export function action_of(event) {
  const control = event.ctrlKey || event.metaKey;
  const is_named = event.key.length > 1 || control;
  const is_letter = /^[a-z]$/i.test(event.key);
  const shift = event.shiftKey && (is_named || is_letter) ? "Shift+" : "";
  // Caps Lock turns letters over, and with Cmd a Mac leaves them small: Shift alone says which is meant.
  const letter = event.shiftKey ? event.key.toUpperCase() : event.key.toLowerCase();
  const key = `${control ? "Ctrl+" : ""}${shift}${is_letter ? letter : event.key}`;
  return event.altKey ? undefined : ACTIONS.get(key);
}

/** Ways to fly by the key's place on the keyboard: [right, up, forward]. */
export const FLIGHT = {
  KeyW: [0, 0, 1],
  KeyS: [0, 0, -1],
  KeyA: [-1, 0, 0],
  KeyD: [1, 0, 0],
  KeyE: [0, 1, 0],
  KeyQ: [0, -1, 0],
};
