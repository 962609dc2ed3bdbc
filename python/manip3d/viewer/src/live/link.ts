// The connection: newest frames in, acknowledgements and commands out; comes back when it is lost.

import { readFrame, type Frame } from "./frame";

const AGAIN_MS = 1000;
const HISTORY = 300; // frames that latency is told of: ten seconds
const CLOCK_EXCHANGES = 10;

/** What became of the frames so far. */
export interface Stats {
  frames: number;
  lost: number; // never sent to this page, as it was still busy with older ones
  bad: number;
  perSecond: number;
  latencyMs: { p50: number; p95: number } | null;
  clockWithinMs: number; // of the server's clock, that latencies are told to
}

/** How far the server's clock is ahead of this one; an exchange says it to half its own length. */
class Clock {
  private best = Infinity;
  aheadMs = 0;

  static now(): number {
    return performance.timeOrigin + performance.now();
  }

  /** Takes an exchange: said at `sentMs` here, answered at `serverMs` there, heard now. */
  take(sentMs: number, serverMs: number): void {
    const heardMs = Clock.now();
    const length = heardMs - sentMs;
    if (!(length >= 0) || length > this.best) return;
    this.best = length;
    this.aheadMs = serverMs - (sentMs + heardMs) / 2;
  }

  /** To half of what an exchange takes. */
  get withinMs(): number {
    return this.best / 2;
  }
}

export class Link {
  private socket: WebSocket | null = null;
  private last: number | null = null;
  private latencies: number[] = [];
  private times: number[] = [];
  private chain: Promise<void> = Promise.resolve();
  private counted = { frames: 0, lost: 0, bad: 0 };
  private clock = new Clock();

  /**
   * @param decode  takes a frame to where it can be drawn
   * @param onState  is told whether there is a connection
   */
  constructor(
    private decode: (frame: Frame) => Promise<void>,
    private onState: (connected: boolean) => void,
  ) {
    this.open();
  }

  send(message: Record<string, string | number>): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  stats(): Stats {
    const sorted = [...this.latencies].sort((a, b) => a - b);
    const share = (p: number): number => sorted[Math.round(p * (sorted.length - 1))];
    const span = this.times.length > 1 ? this.times[this.times.length - 1] - this.times[0] : 0;
    return {
      ...this.counted,
      perSecond: span > 0 ? (1000 * (this.times.length - 1)) / span : 0,
      latencyMs: sorted.length > 0 ? { p50: share(0.5), p95: share(0.95) } : null,
      clockWithinMs: this.clock.withinMs,
    };
  }

  private open(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.last = null;
      this.clock = new Clock();
      for (let number = 0; number < CLOCK_EXCHANGES; number++) {
        setTimeout(() => this.send({ type: "clock", sent_ms: Clock.now() }), 200 * number);
      }
      this.onState(true);
    });
    socket.addEventListener("message", ({ data }) => {
      if (typeof data === "string") {
        const { clock } = JSON.parse(data) as { clock: [number, number] };
        this.clock.take(...clock);
        return;
      }
      // One after the other: images are decoded asynchronously.
      this.chain = this.chain.then(() => this.take(data as ArrayBuffer));
    });
    socket.addEventListener("close", () => {
      this.onState(false);
      setTimeout(() => this.open(), AGAIN_MS);
    });
    this.socket = socket;
  }

  private async take(data: ArrayBuffer): Promise<void> {
    let frame: Frame;
    try {
      frame = readFrame(data);
      await this.decode(frame);
    } catch (error) {
      this.counted.bad += 1;
      console.error(error);
      return;
    }
    const decodedMs = Clock.now() + this.clock.aheadMs;
    this.send({ type: "ack", sequence: frame.sequence, decoded_ms: decodedMs });
    if (this.last !== null && frame.sequence > this.last) {
      this.counted.lost += frame.sequence - this.last - 1;
    }
    this.last = frame.sequence;
    this.counted.frames += 1;
    this.latencies.push(decodedMs - frame.capturedMs);
    this.times.push(performance.now());
    if (this.latencies.length > HISTORY) this.latencies.shift();
    if (this.times.length > HISTORY) this.times.shift();
  }
}
