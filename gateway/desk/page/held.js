// Inputs that are held down: a pointer on the pad, keys, a gamepad's trigger. Losing one releases it.

const KEYS = {
  ArrowUp: [1, 0], KeyW: [1, 0], ArrowDown: [-1, 0], KeyS: [-1, 0], ArrowLeft: [0, 1], KeyA: [0, 1], ArrowRight: [0, -1], KeyD: [0, -1],
  KeyU: [1, 1], KeyO: [1, -1], KeyM: [-1, 1], Period: [-1, -1],
};
const TRIGGER = 5; // the right shoulder button: no gamepad drives that lies on a table
const DEAD_ZONE = 0.12;

export class Held {
  /**
   * @param pad the element that a pointer is held on.
   * @param onchange called at once when something is pressed or let go.
   */
  constructor(pad, onchange = () => {}) {
    this.pad = pad;
    this.keys = new Set();
    this.pointer = null; // {id, forward, left}
    this.padAbort = new AbortController();
    this.needsRelease = false; // of the gamepad's trigger
    const { signal } = this.padAbort;
    const on = (target, names, handler) => names.split(" ").forEach((name) => target.addEventListener(name, handler, { signal }));
    const drop = () => {
      this.letGo();
      onchange();
    };
    on(pad, "pointerdown", (event) => {
      if (this.pointer || event.button !== 0) return;
      pad.setPointerCapture(event.pointerId);
      // The pad's place is read once: the request must not change when the page moves under a resting finger.
      this.box = pad.getBoundingClientRect();
      this.pointer = { id: event.pointerId, ...this.place(event) };
      event.preventDefault();
      pad.focus();
      onchange();
    });
    on(pad, "pointermove", (event) => {
      if (this.pointer?.id === event.pointerId) Object.assign(this.pointer, this.place(event));
    });
    on(pad, "pointerup pointercancel lostpointercapture", (event) => {
      if (this.pointer?.id !== event.pointerId) return;
      this.pointer = null;
      onchange();
    });
    on(pad, "contextmenu", (event) => event.preventDefault());
    on(window, "keydown", (event) => {
      if (!(event.code in KEYS) || event.ctrlKey || event.altKey || event.metaKey || isField(event.target)) return;
      event.preventDefault();
      // A key that was released by a lost focus counts only when it is pressed again.
      if (event.repeat) return;
      this.keys.add(event.code);
      onchange();
    });
    on(window, "keyup", (event) => this.keys.delete(event.code) && onchange());
    on(window, "blur pagehide", drop);
    on(document, "freeze", drop);
    on(document, "visibilitychange", () => document.hidden && drop());
  }

  /** From the middle of the pad: up is forward, left is left; each from -1 to 1. */
  place(event) {
    const { box } = this;
    const share = (value) => (Math.abs(value) < DEAD_ZONE ? 0 : Math.max(-1, Math.min(1, value)));
    return { forward: share(1 - (2 * (event.clientY - box.top)) / box.height), left: share(1 - (2 * (event.clientX - box.left)) / box.width) };
  }

  letGo() {
    this.keys.clear();
    this.pointer = null;
    this.needsRelease = true;
  }

  /** The requested shares of the chosen speed and angle; null if nothing is held. */
  wish() {
    if (document.hidden || !document.hasFocus()) this.letGo();
    if (this.pointer) return this.pointer;
    if (this.keys.size) {
      const sum = (at) => Math.sign([...this.keys].reduce((all, code) => all + KEYS[code][at], 0));
      return { forward: sum(0), left: sum(1) };
    }
    return this.gamepad();
  }

  gamepad() {
    const pad = navigator.getGamepads().find((one) => one?.connected && one.mapping === "standard");
    if (!pad || !pad.buttons[TRIGGER].pressed) {
      this.needsRelease = false;
      return null;
    }
    if (this.needsRelease) return null;
    const share = (value) => (Math.abs(value) < DEAD_ZONE ? 0 : -value);
    return { forward: share(pad.axes[1]), left: share(pad.axes[2]) };
  }

  end() {
    this.letGo();
    this.padAbort.abort();
  }
}

function isField(element) {
  return element instanceof HTMLElement && (element.isContentEditable || ["INPUT", "SELECT", "TEXTAREA"].includes(element.tagName));
}
