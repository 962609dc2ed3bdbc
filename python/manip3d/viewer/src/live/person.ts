// Mesh of the person and the phantom limb: shared vertices, a range of triangles and an image each.

import * as THREE from "three";
import type { Frame } from "./frame";

const VERTEX = /* glsl */ `
  uniform vec3 low;
  uniform vec3 span;
  varying vec2 vTexel;
  varying float vBare;
  varying vec3 vPlace; // metres, in level axes
  void main() {
    vPlace = low + span * position;
    vTexel = uv * (65535.0 / 65534.0);
    vBare = step(65534.5, uv.x * 65535.0);
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;

const FRAGMENT = /* glsl */ `
  uniform sampler2D map;
  uniform float opacity;
  uniform float tint;
  uniform float hatch; // 1: hatch surfaces that the camera cannot see
  uniform vec4 hidden; // centre and radius of a ball that is not drawn: the patient's own head
  varying vec2 vTexel;
  varying float vBare;
  varying vec3 vPlace;
  void main() {
    if (distance(vPlace, hidden.xyz) < hidden.w) discard;
    vec3 color = mix(texture2D(map, vTexel).rgb, vec3(0.55), step(0.01, vBare));
    color = mix(color, vec3(0.20, 0.62, 1.0), tint);
    if (hatch > 0.5 && !gl_FrontFacing) { // the side that faces away from the camera
      float stripe = step(0.5, fract(30.0 * (vPlace.x + vPlace.y + vPlace.z)));
      color = mix(vec3(dot(color, vec3(0.3, 0.59, 0.11))) * 0.6, vec3(0.95, 0.78, 0.35), 0.8 * stripe);
    }
    gl_FragColor = vec4(color, opacity);
  }`;

const OWN_HEAD_M = 0.24;
const BARE = new THREE.DataTexture(new Uint8Array([140, 140, 140, 255]), 1, 1);
BARE.needsUpdate = true;

function material(): THREE.ShaderMaterial {
  return new THREE.ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      map: { value: BARE },
      opacity: { value: 1 },
      tint: { value: 0 },
      low: { value: new THREE.Vector3() },
      span: { value: new THREE.Vector3(1, 1, 1) },
      hatch: { value: 0 },
      hidden: { value: new THREE.Vector4(0, 0, 0, 0) },
    },
    side: THREE.DoubleSide,
  });
}

async function texture(jpeg: Uint8Array): Promise<THREE.Texture> {
  if (jpeg.length === 0) return BARE;
  const image = await createImageBitmap(new Blob([jpeg as BlobPart], { type: "image/jpeg" }));
  const made = new THREE.Texture(image as unknown as HTMLImageElement);
  made.flipY = false; // rows count down, as in the texture coordinates
  made.generateMipmaps = false;
  made.minFilter = THREE.LinearFilter;
  made.needsUpdate = true;
  return made;
}

function dispose(old: THREE.Texture): void {
  if (old === BARE) return;
  (old.image as ImageBitmap | null)?.close();
  old.dispose();
}

/** Vertices and triangles in buffers that grow and never shrink. */
class Range {
  readonly geometry = new THREE.BufferGeometry();
  readonly mesh: THREE.Mesh<THREE.BufferGeometry, THREE.ShaderMaterial>;

  constructor() {
    this.mesh = new THREE.Mesh(this.geometry, material());
    this.mesh.frustumCulled = false; // bounds change with each frame
  }

  /** @param release  frees the buffers of both ranges on the graphics card; called on growth */
  setIndex(faces: Uint16Array | Uint32Array, release: () => void): void {
    const old = this.geometry.getIndex();
    if (old === null || old.array.constructor !== faces.constructor || old.count < faces.length) {
      const grown = faces.slice(0, 0).constructor as Uint16ArrayConstructor;
      const array = new grown(Math.ceil(faces.length * 1.5) + 3);
      release();
      this.geometry.setIndex(new THREE.BufferAttribute(array, 1));
    }
    const index = this.geometry.getIndex() as THREE.BufferAttribute;
    (index.array as Uint16Array).set(faces);
    index.needsUpdate = true;
    this.geometry.setDrawRange(0, faces.length);
    this.mesh.visible = faces.length > 0;
  }
}

export class Person {
  readonly root = new THREE.Group();
  private body = new Range();
  private phantom = new Range();
  private positions = new THREE.BufferAttribute(new Uint16Array(3), 3);
  private texcoords = new THREE.BufferAttribute(new Uint16Array(2), 2, true);

  constructor() {
    this.phantom.mesh.renderOrder = 1;
    this.root.add(this.body.mesh, this.phantom.mesh);
  }

  /** Sets whether the phantom limb is tinted blue, to distinguish it from the body. */
  set tint(on: boolean) {
    this.phantom.mesh.material.uniforms.tint.value = on ? 0.45 : 0;
  }

  /** For the view from the patient's own eyes: hides the head, hatches what the camera cannot see. */
  ownEyes(head: THREE.Vector3 | null): void {
    for (const { mesh } of [this.body, this.phantom]) {
      const { hatch, hidden } = mesh.material.uniforms;
      hatch.value = head ? 1 : 0;
      hidden.value.set(...(head ? head.toArray() : [0, 0, 0]), head ? OWN_HEAD_M : 0);
    }
  }

  async show(frame: Frame): Promise<void> {
    const [color, own] = await Promise.all([
      texture(frame.bodyJpeg),
      frame.sharesImage ? null : texture(frame.phantomJpeg),
    ]);
    this.setTexture(this.body, color);
    this.setTexture(this.phantom, own ?? color);
    this.setVertices(frame);
    const release = (): void => this.release();
    this.body.setIndex(frame.faces.subarray(0, 3 * frame.bodyFaces), release);
    this.phantom.setIndex(frame.faces.subarray(3 * frame.bodyFaces), release);
    this.root.position.fromArray(frame.low);
    this.root.scale.fromArray(frame.step.map((step) => step || 1));
    for (const { mesh } of [this.body, this.phantom]) {
      mesh.material.uniforms.low.value.copy(this.root.position);
      mesh.material.uniforms.span.value.copy(this.root.scale);
    }
    const drawn = this.phantom.mesh.material;
    drawn.uniforms.opacity.value = frame.opacity;
    drawn.transparent = frame.opacity < 1;
  }

  /** Frees both ranges together: they share vertices, and the other would draw freed ones. */
  private release(): void {
    for (const { geometry } of [this.body, this.phantom]) geometry.dispose();
  }

  private setTexture(range: Range, next: THREE.Texture): void {
    const uniform = range.mesh.material.uniforms.map;
    const old = uniform.value as THREE.Texture;
    uniform.value = next;
    const other = range === this.body ? this.phantom : this.body;
    if (other.mesh.material.uniforms.map.value !== old) dispose(old);
  }

  private setVertices({ positions, texcoords, numVertices }: Frame): void {
    if (this.positions.count < numVertices) {
      const count = Math.ceil(1.5 * numVertices);
      this.positions = new THREE.BufferAttribute(new Uint16Array(3 * count), 3);
      this.texcoords = new THREE.BufferAttribute(new Uint16Array(2 * count), 2, true);
      this.release();
      for (const { geometry } of [this.body, this.phantom]) {
        geometry.setAttribute("position", this.positions);
        geometry.setAttribute("uv", this.texcoords);
      }
    }
    (this.positions.array as Uint16Array).set(positions);
    (this.texcoords.array as Uint16Array).set(texcoords);
    this.positions.needsUpdate = true;
    this.texcoords.needsUpdate = true;
  }
}
