// The connection: newest frames in, acknowledgements and commands out; comes back when it is lost.

import { readFrame, type Frame } from "./frame";

const AGAIN_MS = 1000;
const HISTORY = 300; // frames that latency is told of: ten seconds

/** What became of the frames so far. */
export interface Stats {
  frames: number;
  lost: number; // never sent to this page, as it was still busy with older ones
  bad: number;
  perSecond: number;
  latencyMs: { p50: number; p95: number } | null;
}

export class Link {
  private socket: WebSocket | null = null;
  private last: number | null = null;
  private latencies: number[] = [];
  private times: number[] = [];
  private chain: Promise<void> = Promise.resolve();
  private counted = { frames: 0, lost: 0, bad: 0 };

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
    };
  }

  private open(): void {
    const socket = new WebSocket(`ws://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.last = null;
      this.onState(true);
    });
    socket.addEventListener("message", ({ data }) => {
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
    const decodedMs = performance.timeOrigin + performance.now();
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
