// From where the person is seen: on a screen, side by side on a 3D television, in a headset, and from
// the person's own eyes.

import * as THREE from "three";
import type { Status } from "./frame";

export const WAYS = ["screen", "side-by-side"] as const;
export type Way = (typeof WAYS)[number];

const EYES_M = 0.064; // between them
const EYES_AHEAD_M = 0.09; // of the middle of the head
const EYES_ABOVE_M = 0.04;
const LOOK_DOWN = THREE.MathUtils.degToRad(35); // where one's own limbs are
const EYE_S = 0.15; // in which the eyes follow the joints, lest the picture trembles
const RIG_S = 0.6; // in which the room follows the joints; a headset knows its own movements
const HOLD_MS = 1000; // nobody holds a grip for so long by mistake
const STAND_OFF_M = 2.2; // from the mirror image to who looks at it in a headset
const [SPINE, HEAD, LEFT, RIGHT] = [1, 3, 4, 8]; // joints

/** Place and direction of the eyes, in the camera's frame (x right, y down, z ahead). */
export interface Eyes {
  place: THREE.Vector3;
  ahead: THREE.Vector3; // level, of length 1
}

/** Position and direction of the eyes from the joints; null where a joint is not known. */
export function eyesOf({ joints, joint_states: states }: Status): Eyes | null {
  if (!joints || ![SPINE, HEAD, LEFT, RIGHT].every((joint) => states?.[joint])) return null;
  const [head, left, right] = [HEAD, LEFT, RIGHT].map((j) => new THREE.Vector3().fromArray(joints[j]));
  const across = right.sub(left).setY(0); // to the person's right
  if (across.lengthSq() < 1e-6) return null;
  across.normalize();
  // Ahead is up x across; somebody who faces the camera has the right hand at smaller x.
  const ahead = new THREE.Vector3(-across.z, 0, across.x);
  const place = head.addScaledVector(ahead, EYES_AHEAD_M);
  place.y -= EYES_ABOVE_M;
  return { place, ahead };
}

/** The camera that follows the eyes, and the rig that carries it into a headset's space. */
export class Views {
  readonly rig = new THREE.Group();
  readonly stereo = new THREE.StereoCamera();
  way: Way = "screen";
  own = false; // whether the person's own eyes are looked through
  private eyes: Eyes | null = null;
  private turned = { yaw: 0, pitch: 0 }; // by who drags the picture
  private last = 0;

  constructor(
    private renderer: THREE.WebGLRenderer | null, // null: nothing is drawn
    private camera: THREE.PerspectiveCamera,
    private world: THREE.Group,
  ) {
    this.rig.add(camera);
    this.stereo.eyeSep = EYES_M;
    this.stereo.aspect = 1; // the television draws each half out to its full width
  }

  get inHeadset(): boolean {
    return this.renderer?.xr.isPresenting ?? false;
  }

  /** Whether what stands on the page over the picture would be seen wrongly, or not at all. */
  get wantsPanel(): boolean {
    return this.inHeadset || this.way === "side-by-side";
  }

  /** Dragging in one's own view. */
  turn(yaw: number, pitch: number): void {
    this.turned.yaw += yaw;
    this.turned.pitch = THREE.MathUtils.clamp(this.turned.pitch + pitch, -1.2, 1.2);
  }

  look(status: Status, now: number): void {
    const found = eyesOf(status);
    const share = 1 - Math.exp(-Math.max(0, now - this.last) / 1000 / EYE_S);
    this.last = now;
    if (!found) return;
    if (!this.eyes) {
      this.eyes = found;
      return;
    }
    this.eyes.place.lerp(found.place, share);
    this.eyes.ahead.lerp(found.ahead, share).normalize();
  }

  /** Place of the head that would be in one's own way; null: it is seen from outside. */
  get hidden(): THREE.Vector3 | null {
    return this.own && this.eyes ? this.eyes.place : null;
  }

  /** To be called before each picture; says whether it placed the camera itself. */
  place(target: THREE.Vector3, floor: number, seconds: number): boolean {
    const own = this.own && this.eyes ? this.ownPlace(this.eyes) : null;
    if (this.inHeadset) {
      this.placeRig(own, target, floor, seconds);
      return true;
    }
    this.rig.position.set(0, 0, 0);
    this.rig.rotation.set(0, 0, 0);
    if (!own) return false;
    this.camera.position.copy(own.place);
    const { yaw, pitch } = this.turned;
    this.camera.rotation.set(-LOOK_DOWN + pitch, own.yaw + yaw, 0, "YXZ");
    return true;
  }

  private ownPlace({ place, ahead }: Eyes): { place: THREE.Vector3; yaw: number } {
    this.world.updateMatrixWorld();
    const there = place.clone().applyMatrix4(this.world.matrixWorld);
    const way = ahead.clone().transformDirection(this.world.matrixWorld);
    return { place: there, yaw: Math.atan2(-way.x, -way.z) };
  }

  private placeRig(
    own: { place: THREE.Vector3; yaw: number } | null,
    target: THREE.Vector3,
    floor: number,
    seconds: number,
  ): void {
    if (!own) {
      this.rig.rotation.set(0, 0, 0);
      this.rig.position.set(target.x, floor, target.z + STAND_OFF_M);
      return;
    }
    const isNew = this.rig.userData.own !== true;
    this.rig.userData.own = true;
    if (isNew) this.rig.rotation.set(0, own.yaw, 0);
    const head = this.camera.position.clone().applyEuler(this.rig.rotation);
    const wanted = own.place.clone().sub(head);
    if (isNew) this.rig.position.copy(wanted);
    else this.rig.position.lerp(wanted, 1 - Math.exp(-seconds / RIG_S));
  }

  /** One picture, or one for each eye. */
  render(scene: THREE.Scene, distance: number): void {
    const { renderer, camera } = this;
    if (!renderer) return;
    if (this.inHeadset || this.way === "screen") {
      renderer.render(scene, camera);
      return;
    }
    camera.focus = distance; // what is there is on the screen
    scene.updateMatrixWorld();
    this.stereo.update(camera);
    const size = renderer.getSize(new THREE.Vector2());
    const half = Math.floor(size.x / 2);
    renderer.setScissorTest(true);
    [this.stereo.cameraL, this.stereo.cameraR].forEach((eye, which) => {
      renderer.setScissor(which * half, 0, half, size.y);
      renderer.setViewport(which * half, 0, half, size.y);
      renderer.render(scene, eye);
    });
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, size.x, size.y);
  }

  /** `onHold`: called when the grip of a controller is held for a second. */
  async enterHeadset(
    onEnd: () => void,
    onSelect: () => void,
    onHold: () => void,
  ): Promise<XRSession> {
    const session = await navigator.xr!.requestSession("immersive-vr", {
      requiredFeatures: ["local-floor"],
    });
    session.addEventListener("select", onSelect);
    let held = 0;
    const release = (): void => clearTimeout(held);
    session.addEventListener("squeezestart", () => {
      release();
      held = setTimeout(onHold, HOLD_MS);
    });
    session.addEventListener("squeezeend", release);
    session.addEventListener("end", () => {
      release();
      this.rig.userData.own = false;
      onEnd();
    });
    this.rig.userData.own = false;
    try {
      // Where this fails within setSession, three.js leaves a canvas without pixels.
      await this.renderer?.getContext().makeXRCompatible();
      await this.renderer?.xr.setSession(session);
    } catch (error) {
      await session.end().catch(() => undefined); // it may have ended by itself
      throw error;
    }
    return session;
  }
}

/** Whether there is a headset; browsers tell pages of an encrypted or local address only. */
export async function hasHeadset(): Promise<boolean> {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-vr")) ?? false;
  } catch {
    return false;
  }
}
