// The connection to the program: receives frames, sends acknowledgements and commands, reconnects.

import { readFrame, type Frame } from "./frame";
import type { Message } from "./parts";

const RECONNECT_MS = 1000; // from the end of a connection to the next attempt
const HISTORY = 300; // frames over which latency is computed: ten seconds
const CLOCK_EXCHANGES = 10;
const CLOCK_INTERVAL_MS = 200; // the exchanges of two seconds rarely meet the same delay
const MAX_ATTEMPTS = 3; // attempts to send a message that the program does not answer

/** Counts of the frames so far. */
export interface Stats {
  frames: number;
  lost: number; // frames that were not sent, because this page was busy with older ones
  bad: number;
  perSecond: number;
  latencyMs: { p50: number; p95: number } | null;
  clockWithinMs: number; // accuracy of the clock offset to the server, and so of latencies
}

/** Offset of the server's clock to this one, to within half of the duration of an exchange. */
class Clock {
  private best = Infinity;
  aheadMs = 0;

  static now(): number {
    return performance.timeOrigin + performance.now();
  }

  /** Adds an exchange: sent at `sentMs` here, answered at `serverMs` there, received now. */
  take(sentMs: number, serverMs: number): void {
    const heardMs = Clock.now();
    const length = heardMs - sentMs;
    if (!(length >= 0) || length > this.best) return;
    this.best = length;
    this.aheadMs = serverMs - (sentMs + heardMs) / 2;
  }

  /** Accuracy of the offset: half of the duration of the shortest exchange; at first infinite. */
  get withinMs(): number {
    return this.best / 2;
  }
}

/** Text messages of the program. */
interface TextMessage {
  clock?: [number, number];
  taken?: number; // number of a message that the program has received
  heard?: number; // number of a message that is written to the diary
  code?: string;
}

/** Messages about the session itself: in a later one they would mean something else. */
const OF_SESSION = new Set<unknown>(["enough", "unanswered"]);

/** A message that must not be lost. */
interface Kept {
  number: number;
  message: Message;
  attempts: number;
  heard: () => void;
  failed: (error: Error) => void;
}

export class Link {
  private socket: WebSocket | null = null;
  private last: number | null = null;
  private latencies: number[] = [];
  private times: number[] = [];
  private chain: Promise<void> = Promise.resolve();
  private counted = { frames: 0, lost: 0, bad: 0 };
  private clock = new Clock();
  private kept: Kept[] = [];
  private lastNumber = 0; // of the messages that must not be lost
  private readonly page = crypto.getRandomValues(new Uint32Array(1))[0];
  private newestAt = performance.now();

  /**
   * @param decode  prepares a frame for drawing
   * @param onState  called when the connection opens or closes, and when a message waits for it
   * @param onCode  called with a code that admits another screen
   */
  constructor(
    private decode: (frame: Frame) => Promise<void>,
    private onState: (connected: boolean) => void,
    private onCode: (code: string) => void,
  ) {
    this.open();
  }

  send(message: Record<string, string | number>): void {
    if (this.isOpen) this.socket?.send(JSON.stringify(message));
  }

  /** Sends a message, again over each new connection, until the program has confirmed it. */
  keep(message: Message): Promise<void> {
    return new Promise((heard, failed) => {
      const one = { number: ++this.lastNumber, message, attempts: 0, heard, failed };
      this.kept.push(one);
      this.sayAgain(one);
      if (!this.isOpen) this.onState(false);
    });
  }

  /** Number of entries that somebody made and that the program has not confirmed. */
  get unnoted(): number {
    return this.kept.filter(({ message }) => !OF_SESSION.has(message.type)).length;
  }

  private get isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  private sayAgain(one: Kept): void {
    if (!this.isOpen) return;
    one.attempts += 1;
    this.send({ ...one.message, page: this.page, number: one.number });
  }

  /** Notes that a message has arrived at the program, which may still have to write it. */
  private taken(number: number): void {
    const one = this.kept.find((kept) => kept.number === number);
    if (one) one.attempts = 0;
  }

  private heard(number: number): void {
    const one = this.kept.find((kept) => kept.number === number);
    this.kept = this.kept.filter((kept) => kept !== one);
    one?.heard();
  }

  /** Seconds since the last picture that could be shown. */
  get silentS(): number {
    return (performance.now() - this.newestAt) / 1000;
  }

  stats(): Stats {
    const sorted = [...this.latencies].sort((a, b) => a - b);
    const share = (p: number): number => sorted[Math.round(p * (sorted.length - 1))];
    // The time until now counts, so that the rate falls while no picture arrives.
    const span = this.times.length > 1 ? performance.now() - this.times[0] : 0;
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
        setTimeout(() => this.send({ type: "clock", sent_ms: Clock.now() }), CLOCK_INTERVAL_MS * number);
      }
      const lost = this.kept.filter((one) => one.attempts >= MAX_ATTEMPTS);
      this.kept = this.kept.filter((one) => one.attempts < MAX_ATTEMPTS);
      for (const one of lost) one.failed(new Error("the connection was lost each time"));
      for (const one of this.kept) this.sayAgain(one);
      this.newestAt = performance.now();
      this.onState(true);
    });
    socket.addEventListener("message", ({ data }) => {
      if (typeof data === "string") {
        this.read(data);
        return;
      }
      // Images are decoded asynchronously; the chain keeps frames in order.
      this.chain = this.chain.then(() => this.take(data as ArrayBuffer, socket));
    });
    socket.addEventListener("close", () => {
      this.onState(false);
      setTimeout(() => this.open(), RECONNECT_MS);
    });
    this.socket = socket;
  }

  /** Handles a text message; one that is not JSON is reported and ignored. */
  private read(text: string): void {
    let message: TextMessage;
    try {
      message = JSON.parse(text) as TextMessage;
    } catch (error) {
      console.error(error);
      return;
    }
    if (message.clock) this.clock.take(...message.clock);
    if (message.taken !== undefined) this.taken(message.taken);
    if (message.heard !== undefined) this.heard(message.heard);
    if (message.code !== undefined) this.onCode(message.code);
  }

  private async take(data: ArrayBuffer, socket: WebSocket): Promise<void> {
    if (socket !== this.socket) return; // a frame of an older connection
    let frame: Frame;
    try {
      frame = readFrame(data);
      await this.decode(frame);
    } catch (error) {
      this.counted.bad += 1;
      console.error(error);
      // The program sends at most two frames without an answer.
      if (socket === this.socket) this.send({ type: "bad" });
      return;
    }
    if (socket !== this.socket) return; // a new connection was opened while the frame was decoded
    this.acknowledge(frame);
    if (this.last !== null && frame.sequence > this.last) {
      this.counted.lost += frame.sequence - this.last - 1;
    }
    this.last = frame.sequence;
    this.counted.frames += 1;
    this.newestAt = performance.now();
    this.times.push(performance.now());
    if (this.times.length > HISTORY) this.times.shift();
  }

  /** Acknowledges a frame, with the time of decoding once the offset of the clocks is known. */
  private acknowledge({ sequence, capturedMs }: Frame): void {
    if (this.clock.withinMs === Infinity) {
      this.send({ type: "ack", sequence });
      return;
    }
    const decodedMs = Clock.now() + this.clock.aheadMs;
    this.send({ type: "ack", sequence, decoded_ms: decodedMs });
    this.latencies.push(decodedMs - capturedMs);
    if (this.latencies.length > HISTORY) this.latencies.shift();
  }
}
