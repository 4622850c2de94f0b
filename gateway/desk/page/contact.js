// The age of what the page shows, by the page's own clock: a hanging or dead process does not report itself.

export const FRESH_MS = 1000; // as for `cruiser watch`: older than that nothing is shown as current

const DRIFT = 0.01; // a clock that is being set right runs this much fast or slow, at most

/** Compares a robot's times with the page's: a sample slower than the quickest one has waited on the way. */
export class SampleClock {
  constructor() {
    this.quickestMs = this.atMs = this.saidMs = -Infinity;
  }

  /** The time that a sample waited on the way, beyond the quickest one. */
  delayMs(saidNs, nowMs) {
    const saidMs = Number(saidNs) / 1e6;
    const tookMs = nowMs - saidMs;
    // A robot's clock that was set back makes nothing old.
    const isSetBack = saidMs < this.saidMs - FRESH_MS;
    const quickestMs = this.quickestMs + DRIFT * (nowMs - this.atMs);
    this.quickestMs = isSetBack || this.atMs === -Infinity ? tookMs : Math.min(tookMs, quickestMs);
    this.atMs = nowMs;
    this.saidMs = saidMs;
    return tookMs - this.quickestMs;
  }
}
