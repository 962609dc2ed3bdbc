// Synthesised sounds: a pop for a bubble, a tick for a touch, a note for a key.

const SCALE = [0, 2, 4, 5, 7, 9, 11]; // semitones of a major scale
const MIDDLE_C = 261.63; // hertz
const LOUDNESS = 0.2;

/** The pitch of a key, counted from the left. */
export function pitch(key: number): number {
  const octave = Math.floor(key / SCALE.length);
  return MIDDLE_C * 2 ** (octave + SCALE[key % SCALE.length] / 12);
}

/** Plays the sounds of events. Browsers allow sound only after the user has pressed something. */
export class Sound {
  private context: AudioContext | null = null;
  on = true;
  played: { kind: string; hertz: number }[] = []; // the last sounds, for tests

  /** Must be called when the user presses something. */
  wake(): void {
    this.context ??= "AudioContext" in globalThis ? new AudioContext() : null;
    if (this.context?.state === "suspended") void this.context.resume();
  }

  event(kind: string, key: number): void {
    if (!this.on) return;
    if (kind === "burst") this.tone(kind, 620, 0.12, 0.6);
    if (kind === "stroke") this.tone(kind, 330, 0.1, 1);
    if (kind === "arrived") this.tone(kind, 880, 0.9, 1);
    if (kind === "touch") this.tone(kind, 1200, 0.06, 0.9);
    if (kind === "note") this.tone(kind, pitch(key), 0.8, 1);
  }

  /** Plays a decaying tone, whose pitch ends at `bend` times `hertz`. */
  private tone(kind: string, hertz: number, seconds: number, bend: number): void {
    this.played = [...this.played.slice(-31), { kind, hertz }];
    const context = this.context;
    if (!context || context.state !== "running") return;
    const [source, gain, now] = [
      context.createOscillator(),
      context.createGain(),
      context.currentTime,
    ];
    source.type = "triangle";
    source.frequency.setValueAtTime(hertz, now);
    source.frequency.exponentialRampToValueAtTime(hertz * bend, now + seconds);
    gain.gain.setValueAtTime(LOUDNESS, now);
    gain.gain.exponentialRampToValueAtTime(0.001, now + seconds);
    source.connect(gain).connect(context.destination);
    source.start(now);
    source.stop(now + seconds);
  }
}
