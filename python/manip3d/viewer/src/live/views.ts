// Views of the person: on a screen, side by side on a 3D television, in a headset, and from the
// person's own eyes.

import * as THREE from "three";
import type { Status } from "./frame";

export const WAYS = ["screen", "side-by-side"] as const;
export type Way = (typeof WAYS)[number];

const EYES_M = 0.064; // distance between the eyes
const EYES_AHEAD_M = 0.09; // distance of the eyes before the middle of the head
const EYES_ABOVE_M = 0.04;
const LOOK_DOWN = THREE.MathUtils.degToRad(35); // pitch of the own view, towards the limbs
const EYE_S = 0.15; // time constant with which the eyes follow the joints, against jitter
const RIG_S = 0.6; // the same for the room in a headset, which tracks the head itself
const HOLD_MS = 1000; // duration of an intended grip; accidental ones are shorter
const STAND_OFF_M = 2.2; // distance of a headset's wearer from the mirror image
const [SPINE, HEAD, LEFT, RIGHT] = [1, 3, 4, 8]; // numbers of joints; the sides are shoulders

/** Place and direction of the eyes, in level axes (x right, y down along the vertical, z ahead). */
export interface Eyes {
  place: THREE.Vector3;
  ahead: THREE.Vector3; // horizontal unit vector
}

/** Position and direction of the eyes from the joints; null where a joint is not known. */
export function eyesOf({ joints, joint_states: states }: Status): Eyes | null {
  if (!joints || ![SPINE, HEAD, LEFT, RIGHT].every((joint) => states?.[joint])) return null;
  const [head, left, right] = [HEAD, LEFT, RIGHT].map((j) => new THREE.Vector3().fromArray(joints[j]));
  const across = right.sub(left).setY(0); // to the person's right
  if (across.lengthSq() < 1e-6) return null;
  across.normalize();
  // Ahead is the cross product of up and across.
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
  own = false; // whether the view is from the person's own eyes
  private eyes: Eyes | null = null;
  private turned = { yaw: 0, pitch: 0 }; // rotation by dragging the picture
  private last = 0;

  constructor(
    private renderer: THREE.WebGLRenderer | null, // null: nothing is drawn
    private camera: THREE.PerspectiveCamera,
    private world: THREE.Group,
  ) {
    this.rig.add(camera);
    this.stereo.eyeSep = EYES_M;
    this.stereo.aspect = 1; // the television stretches each half to its full width
  }

  get inHeadset(): boolean {
    return this.renderer?.xr.isPresenting ?? false;
  }

  /** Whether elements of the page over the picture cannot be read, as in a headset. */
  get wantsPanel(): boolean {
    return this.inHeadset || this.way === "side-by-side";
  }

  /** Rotates the view from the patient's own eyes by dragging. */
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

  /** Place of the patient's head if the view is from their own eyes, else null. */
  get hidden(): THREE.Vector3 | null {
    return this.own && this.eyes ? this.eyes.place : null;
  }

  /** Must be called before each picture; returns whether it has placed the camera. */
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

  /** Draws one picture, or one for each eye. */
  render(scene: THREE.Scene, distance: number): void {
    const { renderer, camera } = this;
    if (!renderer) return;
    if (this.inHeadset || this.way === "screen") {
      renderer.render(scene, camera);
      return;
    }
    camera.focus = distance; // objects at this distance appear in the plane of the screen
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
      // If this fails within setSession, three.js leaves a canvas of size 0.
      await this.renderer?.getContext().makeXRCompatible();
      await this.renderer?.xr.setSession(session);
    } catch (error) {
      await session.end().catch(() => undefined); // the session may have ended already
      throw error;
    }
    return session;
  }
}

/** Whether there is a headset. Browsers tell this only to pages with an encrypted or local address. */
export async function hasHeadset(): Promise<boolean> {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-vr")) ?? false;
  } catch {
    return false;
  }
}
