// A board in the scene with the texts of the page, for headsets and the side-by-side view.

import * as THREE from "three";

const WIDE = 1024;
const HIGH = 384;
const SIZE_M = 1.2;

export class Panel {
  readonly root: THREE.Mesh<THREE.PlaneGeometry, THREE.MeshBasicMaterial>;
  private canvas = document.createElement("canvas");
  private texture: THREE.CanvasTexture;
  said = "";

  constructor() {
    this.canvas.width = WIDE;
    this.canvas.height = HIGH;
    this.texture = new THREE.CanvasTexture(this.canvas);
    this.texture.colorSpace = THREE.SRGBColorSpace;
    this.root = new THREE.Mesh(
      new THREE.PlaneGeometry(SIZE_M, (SIZE_M * HIGH) / WIDE),
      new THREE.MeshBasicMaterial({ map: this.texture, transparent: true, depthTest: false }),
    );
    this.root.renderOrder = 10;
    this.root.visible = false;
  }

  /** Draws lines of text, the first one large, if they have changed. */
  say(lines: string[]): void {
    const text = lines.join("\n");
    if (text === this.said) return;
    this.said = text;
    const pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
    pen.clearRect(0, 0, WIDE, HIGH);
    pen.fillStyle = "rgb(16 19 25 / 0.85)";
    pen.beginPath();
    pen.roundRect(0, 0, WIDE, HIGH, 32);
    pen.fill();
    pen.fillStyle = "#f1f4f8";
    pen.textAlign = "center";
    let y = 74;
    lines.forEach((line, which) => {
      pen.font = which === 0 ? "600 60px system-ui, sans-serif" : "40px system-ui, sans-serif";
      for (const part of wrapped(pen, line, WIDE - 80)) {
        pen.fillText(part, WIDE / 2, y);
        y += which === 0 ? 68 : 52;
      }
    });
    this.texture.needsUpdate = true;
  }
}

function wrapped(pen: CanvasRenderingContext2D, text: string, width: number): string[] {
  const lines: string[] = [];
  for (const word of text.split(" ")) {
    const longer = lines.length > 0 ? `${lines[lines.length - 1]} ${word}` : word;
    if (lines.length > 0 && pen.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}
