// How old is what the page shows? By the page's own clock: a process that hangs or has died does not say so.

export const FRESH_MS = 1000; // as for `cruiser watch`: older than that nothing is shown as current

const DRIFT = 0.01; // a clock that is being set right runs this much fast or slow, at most

/** A robot's own times beside the page's: what took longer to come than the quickest has waited on the way. */
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
