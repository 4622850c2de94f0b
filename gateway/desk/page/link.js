// The WebSocket to the desk: MessagePack maps with `is` as their type. It reconnects automatically.

const FIRST_WAIT_MS = 300;
const LONGEST_WAIT_MS = 3000;
const SILENT_MS = 3000; // the desk sends five times a second: after a longer silence it hangs or cannot be reached
const LOOK_MS = 500;

export class Link {
  constructor() {
    this.handlers = new Map();
    this.questions = new Map();
    this.number = 0;
    this.wait = FIRST_WAIT_MS;
    this.socket = null;
    this.connected = false;
    this.heardMs = performance.now();
    this.openedMs = 0;
    this.open();
    setInterval(() => this.connected && Math.min(this.silentMs, performance.now() - this.openedMs) > SILENT_MS && this.lose(this.socket), LOOK_MS);
  }

  /** Time since the desk's last message, by this page's clock, so that a hang of any process is noticed. */
  get silentMs() {
    return performance.now() - this.heardMs;
  }

  /** Add a listener for a kind of message, or for `opened` and `closed`. */
  on(kind, handler) {
    this.handlers.set(kind, [...(this.handlers.get(kind) ?? []), handler]);
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/link`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => {
      this.heardMs = performance.now();
      this.receive(MessagePack.decode(new Uint8Array(event.data)));
    };
    socket.onopen = () => {
      this.connected = true;
      this.openedMs = performance.now();
      this.wait = FIRST_WAIT_MS;
      this.emit("opened", {});
    };
    socket.onclose = () => this.lose(socket);
    this.socket = socket;
  }

  /** The connection has ended or hangs: make another one. */
  lose(socket) {
    socket.onmessage = socket.onopen = socket.onclose = null;
    socket.close();
    this.connected = false;
    for (const question of this.questions.values()) question.done();
    this.questions.clear();
    this.emit("closed", {});
    setTimeout(() => this.open(), this.wait);
    this.wait = Math.min(2 * this.wait, LONGEST_WAIT_MS);
  }

  receive(message) {
    if (message.is === "reply") {
      const question = this.questions.get(message.number);
      if (question === undefined) return;
      if (!message.last) return question.replies.push(message);
      this.questions.delete(message.number);
      return question.done();
    }
    this.emit(message.is, message);
  }

  emit(kind, message) {
    for (const handler of this.handlers.get(kind) ?? []) handler(message);
  }

  /** Send; false without a connection. Nothing is queued: an old command is worse than none. */
  send(message) {
    if (!this.connected) return false;
    this.socket.send(MessagePack.encode(message));
    return true;
  }

  /** Send a query, and return all replies. */
  ask(message) {
    const number = ++this.number;
    return new Promise((resolve) => {
      const replies = [];
      if (!this.send({ ...message, number })) return resolve(replies);
      this.questions.set(number, { replies, done: () => resolve(replies) });
    });
  }
}
