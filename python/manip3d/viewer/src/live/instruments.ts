// Fixed objects of the games for feet: keys of the piano, columns and disks of the pedals.

import * as THREE from "three";
import type { GameStatus } from "./frame";

const KEY = { wide: 0.14, high: 0.03, long: 0.3, radius: 0.11 }; // metres, of an adult's keys
const SIDES = ["#38b6ff", "#ff7ab8"]; // colours of the balls: left, right

function matt(color: string, more: object = {}): THREE.MeshStandardMaterial {
  return new THREE.MeshStandardMaterial({ color, roughness: 0.6, ...more });
}

/** A row of keys on the floor; the active key glows and is raised. */
export class Piano {
  readonly root = new THREE.Group();
  private keys: THREE.Mesh[] = [];
  private box = new THREE.BoxGeometry(KEY.wide, KEY.high, KEY.long);
  private idle = matt("#e8e9ec");
  private lit = matt("#ffb000", { emissive: "#ff9500", emissiveIntensity: 0.9 });

  show({ keys: places = [], up = -1, radius = KEY.radius }: GameStatus): void {
    const size = radius / KEY.radius;
    while (this.keys.length > places.length) this.root.remove(this.keys.pop() as THREE.Mesh);
    while (this.keys.length < places.length) {
      const made = new THREE.Mesh(this.box, this.idle);
      this.keys.push(made);
      this.root.add(made);
    }
    places.forEach(([x, y, z], which) => {
      const key = this.keys[which];
      const isUp = which === up;
      key.material = isUp ? this.lit : this.idle;
      key.scale.set(size, isUp ? 2.5 : 1, size);
      key.position.set(x, y + 0.06 - (isUp ? 0.02 : 0), z - 0.04); // under the sole
    });
  }
}

/** A column over each pedal; the ball rises to the disk at its upper end. */
export class Pedals {
  readonly root = new THREE.Group();
  private parts: { rail: THREE.Mesh; disk: THREE.Mesh; foot: THREE.Mesh }[];

  constructor() {
    const thin = new THREE.CylinderGeometry(0.008, 0.008, 1, 12);
    const flat = new THREE.CylinderGeometry(0.11, 0.11, 0.02, 40);
    const pedal = new THREE.BoxGeometry(0.12, 0.025, 0.26);
    this.parts = SIDES.map((color) => {
      const rail = new THREE.Mesh(thin, matt("#8793a6"));
      const disk = new THREE.Mesh(flat, matt(color, { emissive: color, emissiveIntensity: 0.35 }));
      const foot = new THREE.Mesh(pedal, matt("#5d6878"));
      this.root.add(rail, disk, foot);
      return { rail, disk, foot };
    });
    this.root.visible = false; // until there is a game
  }

  show({ disks, starts }: GameStatus): void {
    this.root.visible = Boolean(disks && starts);
    if (!disks || !starts) return;
    this.parts.forEach(({ rail, disk, foot }, side) => {
      const [[x, top, z], bottom] = [disks[side], starts[side][1]];
      rail.position.set(x, (top + bottom) / 2, z);
      rail.scale.y = bottom - top;
      disk.position.set(x, top - 0.07, z); // the ball hits it from below
      foot.position.set(x, bottom + 0.08, z);
    });
  }
}
