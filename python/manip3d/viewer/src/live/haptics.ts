// A short vibration at a hit: of that hand's controller, else of another one, else of the device.

const STRENGTH = 0.7;
const MS = 80;
const LEFT_BONES = new Set([5, 6, 7, 21, 22, 13, 14, 15]);

export class Haptics {
  on = true;
  pulses: { hand: string; ms: number }[] = []; // the last pulses, for tests

  /** @param session  session of a headset, if one is running */
  hit(bone: number, session: XRSession | null): void {
    if (!this.on) return;
    const hand = LEFT_BONES.has(bone) ? "left" : "right";
    const sources = [...(session?.inputSources ?? [])].filter((one) => motorOf(one) !== null);
    const source = sources.find((one) => one.handedness === hand) ?? sources[0];
    if (source) {
      void motorOf(source)?.pulse(STRENGTH, MS);
      this.note(source.handedness);
    } else if (typeof navigator.vibrate === "function" && navigator.userActivation?.hasBeenActive) {
      navigator.vibrate(MS);
      this.note("device");
    }
  }

  private note(hand: string): void {
    this.pulses = [...this.pulses.slice(-31), { hand, ms: MS }];
  }
}

interface Motor {
  pulse(strength: number, ms: number): Promise<boolean>;
}

function motorOf(source: XRInputSource): Motor | null {
  const pad = source.gamepad as (Gamepad & { hapticActuators?: Motor[] }) | undefined;
  return pad?.hapticActuators?.[0] ?? null;
}
