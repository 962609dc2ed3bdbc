// Everything drawn besides the person: skeleton, colliders, bubbles, stains and the room.

import * as THREE from "three";
import type { GameStatus, Status } from "./frame";

const BURST_MS = 450;
const SPARKS_MS = 900;
const SPARKS = 24;

/** Lines between joints; yellow at inferred joints. */
export class Bones {
  readonly root: THREE.LineSegments;
  private place: THREE.BufferAttribute;
  private color: THREE.BufferAttribute;

  constructor(private parents: number[]) {
    const count = 2 * parents.length;
    this.place = new THREE.BufferAttribute(new Float32Array(3 * count), 3);
    this.color = new THREE.BufferAttribute(new Float32Array(3 * count), 3);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", this.place);
    geometry.setAttribute("color", this.color);
    const drawn = new THREE.LineBasicMaterial({ vertexColors: true, depthTest: false });
    this.root = new THREE.LineSegments(geometry, drawn);
    this.root.frustumCulled = false;
    this.root.renderOrder = 3;
  }

  show({ joints, joint_states: states }: Status): void {
    let used = 0;
    this.parents.forEach((parent, bone) => {
      if (bone === 0 || !joints || !states || !states[bone] || !states[parent]) return;
      const guessed = states[bone] === 1 || states[parent] === 1;
      for (const end of [parent, bone]) {
        this.place.setXYZ(used, joints[end][0], joints[end][1], joints[end][2]);
        this.color.setXYZ(used, 1, guessed ? 0.75 : 1, guessed ? 0.1 : 1);
        used += 1;
      }
    });
    this.root.geometry.setDrawRange(0, used);
    this.place.needsUpdate = true;
    this.color.needsUpdate = true;
  }
}

const UP = new THREE.Vector3(0, 1, 0);

/** A capsule for each bone and a box for the trunk. */
export class Colliders {
  readonly root = new THREE.Group();
  private capsules: { shaft: THREE.Mesh; ends: THREE.Mesh[] }[] = [];
  private torso: THREE.Mesh;

  constructor(count: number) {
    const drawn = new THREE.MeshBasicMaterial({
      color: "#58d68d",
      wireframe: true,
      transparent: true,
      opacity: 0.45,
    });
    const shaft = new THREE.CylinderGeometry(1, 1, 1, 10, 1, true);
    const ball = new THREE.SphereGeometry(1, 10, 6);
    for (let bone = 0; bone < count; bone++) {
      const parts = [new THREE.Mesh(shaft, drawn), new THREE.Mesh(ball, drawn)];
      const [middle, first] = parts;
      const last = new THREE.Mesh(ball, drawn);
      this.capsules.push({ shaft: middle, ends: [first, last] });
      this.root.add(middle, first, last);
    }
    this.torso = new THREE.Mesh(new THREE.BoxGeometry(2, 2, 2), drawn);
    this.torso.matrixAutoUpdate = false;
    this.root.add(this.torso);
    for (const part of this.root.children) part.visible = false; // until a person is seen
  }

  show({ colliders, torso }: Status): void {
    const [from, to, way] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
    this.capsules.forEach(({ shaft, ends }, bone) => {
      const [ax, ay, az, bx, by, bz, radius] = colliders?.[bone] ?? [0, 0, 0, 0, 0, 0, 0];
      from.set(ax, ay, az);
      to.set(bx, by, bz);
      way.subVectors(to, from);
      const length = way.length();
      ends.forEach((end, which) => {
        end.visible = radius > 0;
        end.position.copy(which === 0 ? from : to);
        end.scale.setScalar(Math.max(radius, 1e-6));
      });
      shaft.visible = radius > 0 && length > 1e-6;
      if (!shaft.visible) return;
      shaft.position.addVectors(from, to).multiplyScalar(0.5);
      shaft.quaternion.setFromUnitVectors(UP, way.divideScalar(length));
      shaft.scale.set(radius, length, radius);
    });
    this.torso.visible = Boolean(torso);
    if (!torso) return;
    const [x, y, z] = torso.axes.map((axis) => new THREE.Vector3().fromArray(axis));
    this.torso.matrix
      .makeBasis(x, y, z)
      .scale(new THREE.Vector3().fromArray(torso.half))
      .setPosition(new THREE.Vector3().fromArray(torso.centre));
  }
}

interface Sparks {
  points: THREE.Points<THREE.BufferGeometry, THREE.PointsMaterial>;
  ways: THREE.Vector3[];
  began: number;
}

interface Burst {
  ring: THREE.Mesh<THREE.RingGeometry, THREE.MeshBasicMaterial>;
  began: number;
}

/** The bubbles of a game. */
export class Bubbles {
  readonly root = new THREE.Group();
  private bubbles = new Map<number, THREE.Mesh>();
  private stains: THREE.Mesh[] = [];
  private bursts: Burst[] = [];
  private sparks: Sparks[] = [];
  private ball = new THREE.SphereGeometry(1, 24, 16);
  private disk = new THREE.CircleGeometry(0.1, 24);
  private drawn = ["#38b6ff", "#ff7ab8"].map(
    (color) =>
      new THREE.MeshPhongMaterial({
        color,
        transparent: true,
        opacity: 0.72,
        shininess: 90,
        specular: "#ffffff",
        emissive: color,
        emissiveIntensity: 0.25,
      }),
  );
  private stain = new THREE.MeshBasicMaterial({
    color: "#c0392b",
    transparent: true,
    opacity: 0.6,
    side: THREE.DoubleSide,
  });

  constructor(private still: () => boolean) {}

  show(game: GameStatus): void {
    const present = new Set<number>();
    for (const [number, x, y, z] of game.targets ?? []) {
      present.add(number);
      let bubble = this.bubbles.get(number);
      if (!bubble) {
        bubble = new THREE.Mesh(this.ball, this.drawn[number % 2]);
        bubble.scale.setScalar(game.radius ?? 0.1);
        bubble.renderOrder = 2;
        this.bubbles.set(number, bubble);
        this.root.add(bubble);
      }
      bubble.position.set(x, y, z);
    }
    for (const [number, bubble] of this.bubbles) {
      if (present.has(number)) continue;
      this.root.remove(bubble);
      this.bubbles.delete(number);
    }
    for (const [kind, , , x, y, z] of game.events ?? []) {
      if (kind === "missed" || kind === "stroke" || this.still()) continue;
      this.burst(Number(x), Number(y), Number(z));
      if (kind !== "burst") this.sparkle(Number(x), Number(y), Number(z));
    }
    this.showStains(game.stains ?? []);
  }

  private showStains(places: number[][]): void {
    while (this.stains.length > places.length) this.root.remove(this.stains.pop() as THREE.Mesh);
    while (this.stains.length < places.length) {
      const made = new THREE.Mesh(this.disk, this.stain);
      made.rotation.x = Math.PI / 2.4; // tilted towards the viewer
      this.stains.push(made);
      this.root.add(made);
    }
    places.forEach((place, which) => this.stains[which].position.fromArray(place));
  }

  private burst(x: number, y: number, z: number): void {
    const drawn = new THREE.MeshBasicMaterial({
      color: "#fff3b0",
      transparent: true,
      side: THREE.DoubleSide,
      depthTest: false,
    });
    const ring = new THREE.Mesh(new THREE.RingGeometry(0.8, 1, 32), drawn);
    ring.position.set(x, y, z);
    ring.renderOrder = 4;
    this.bursts.push({ ring, began: performance.now() });
    this.root.add(ring);
  }

  private sparkle(x: number, y: number, z: number): void {
    const ways = Array.from({ length: SPARKS }, (_, which) => {
      const turn = (2 * Math.PI * which) / SPARKS;
      const high = 0.25 + 0.2 * (which % 3);
      return new THREE.Vector3(0.22 * Math.cos(turn), -high, 0.22 * Math.sin(turn));
    });
    const drawn = new THREE.PointsMaterial({
      color: "#ffe066",
      size: 0.045,
      transparent: true,
      depthTest: false,
    });
    const points = new THREE.Points(new THREE.BufferGeometry().setFromPoints(ways), drawn);
    points.position.set(x, y, z);
    points.renderOrder = 4;
    points.frustumCulled = false;
    this.sparks.push({ points, ways, began: performance.now() });
    this.root.add(points);
  }

  private animateSparks(now: number): void {
    this.sparks = this.sparks.filter(({ points, ways, began }) => {
      const share = Math.max(0, (now - began) / SPARKS_MS);
      const places = points.geometry.getAttribute("position") as THREE.BufferAttribute;
      ways.forEach((way, which) => {
        const fall = 0.25 * share * share; // y is down
        places.setXYZ(which, way.x * share, way.y * share + fall, way.z * share);
      });
      places.needsUpdate = true;
      points.material.opacity = Math.max(0, 1 - share);
      if (share < 1) return true;
      this.root.remove(points);
      points.geometry.dispose();
      points.material.dispose();
      return false;
    });
  }

  /** Advances the animation of rings and sparks. */
  animate(now: number): void {
    this.animateSparks(now);
    this.bursts = this.bursts.filter(({ ring, began }) => {
      const share = (now - began) / BURST_MS;
      ring.scale.setScalar(0.08 + 0.16 * share);
      ring.material.opacity = Math.max(0, 1 - share);
      if (share < 1) return true;
      this.root.remove(ring);
      ring.geometry.dispose();
      ring.material.dispose();
      return false;
    });
  }
}

/** The ball of the touch cue that strokes the phantom limb, and the limb as the patient feels it. */
export class Cues {
  readonly root = new THREE.Group();
  private ball: THREE.Mesh;
  private felt: { shaft: THREE.Mesh; end: THREE.Mesh }[];

  constructor() {
    const drawn = new THREE.MeshPhongMaterial({ color: "#ffd54a", emissive: "#a06a00" });
    this.ball = new THREE.Mesh(new THREE.SphereGeometry(0.045, 24, 16), drawn);
    const ghost = new THREE.MeshBasicMaterial({
      color: "#c9a6ff",
      transparent: true,
      opacity: 0.55,
      depthTest: false,
    });
    this.felt = [0.05, 0.04].map((radius) => {
      const shaft = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 1, 16), ghost);
      const end = new THREE.Mesh(new THREE.SphereGeometry(radius * 1.15, 16, 12), ghost);
      shaft.renderOrder = end.renderOrder = 2;
      this.root.add(shaft, end);
      return { shaft, end };
    });
    this.root.add(this.ball);
    for (const part of this.root.children) part.visible = false; // until there is something to show
  }

  show({ touch, felt }: Status): void {
    this.ball.visible = Boolean(touch?.place);
    if (touch?.place) {
      const [x, y, z] = touch.place;
      this.ball.position.set(x, y, z - 0.07); // on the side of the camera
    }
    this.felt.forEach(({ shaft, end }, which) => {
      shaft.visible = end.visible = Boolean(felt);
      if (!felt) return;
      const from = new THREE.Vector3().fromArray(felt[which]);
      const to = new THREE.Vector3().fromArray(felt[which + 1]);
      const way = to.clone().sub(from);
      const length = Math.max(way.length(), 1e-4);
      shaft.position.copy(from).addScaledVector(way, 0.5);
      shaft.scale.set(1, length, 1);
      shaft.quaternion.setFromUnitVectors(UP, way.divideScalar(length));
      end.position.copy(to);
    });
  }
}

/** The floor under the person. */
export function room(): THREE.GridHelper {
  const floor = new THREE.GridHelper(6, 12, "#7c8aa0", "#3d4656");
  floor.position.set(0, 0.95, 2.4);
  return floor;
}
