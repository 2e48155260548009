// Where one looks from. Lengths are radii of the first asset, whose centre is 0 0 0.

import {Box3, MathUtils, OrthographicCamera, PerspectiveCamera, Spherical, Vector3} from 'three';
import {OrbitControls} from 'three/addons/controls/OrbitControls.js';

export const VIEWS = [[0, 0, 1], [0, 0, -1], [-1, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]]; // front, back, left, right, top, bottom
const MARGIN = 1.06, NEAREST = 0.01, AWAY = 4, FOV = 40; // AWAY: of a camera without perspective
const {degToRad, radToDeg} = MathUtils;

export class View {
  /** changed: called when the camera moves. */
  constructor(canvas, changed) {
    Object.assign(this, {flat: new OrthographicCamera(), deep: new PerspectiveCamera(FOV), reach: 1, size: [1, 1], changed});
    this.camera = this.flat;
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener('change', changed);
    this.fitted = '';
  }

  get isDeep() {
    return this.camera === this.deep;
  }

  /** Sets the shape of the picture, and the depths that are drawn. reach: radius about 0 0 0 in which everything is. */
  aim([width, height], reach) {
    const {camera, flat, deep} = this, aspect = width / Math.max(1, height);
    Object.assign(this, {size: [width, height], reach});
    Object.assign(flat, {left: -aspect, right: aspect, top: 1, bottom: -1});
    deep.aspect = aspect;
    const middle = camera.position.dot(camera.getWorldDirection(new Vector3()).negate());
    camera.far = middle + 1.01 * reach;
    camera.near = this.isDeep ? Math.max(middle - 1.01 * reach, 1e-3 * Math.max(camera.far, 1e-6)) : middle - 1.01 * reach;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  /** How far away the target is; half the height of what is seen, for an orthographic camera. */
  get distance() {
    return this.isDeep ? this.deep.position.distanceTo(this.controls.target) : 1 / this.flat.zoom;
  }

  get angles() {
    const {theta, phi} = new Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    return [radToDeg(theta), 90 - radToDeg(phi)];
  }

  /** Azimuth, elevation, distance, target and field of view (0: none), as a link holds them. */
  get link() {
    return [...this.angles, this.distance, ...this.controls.target.toArray(), this.isDeep ? this.deep.fov : 0].map((v) => +v.toFixed(4)).join(',');
  }

  set link(text) {
    const [azimuth, elevation, distance, x, y, z, fov, ...rest] = text.split(',').map(Number);
    if (![azimuth, elevation, distance, x, y, z, fov].every(Number.isFinite) || rest.length || !(distance > 0) || !(fov >= 0 && fov < 180)) {
      throw new Error(`${text} is no camera: azimuth,elevation,distance,x,y,z,fov`);
    }
    this.fitted = '';
    this.controls.target.set(x, y, z);
    this.set({azimuth, elevation, distance, fov});
  }

  set({azimuth = this.angles[0], elevation = this.angles[1], distance = this.distance, fov = this.isDeep ? this.deep.fov : 0}) {
    this.camera = this.controls.object = fov ? this.deep : this.flat;
    if (fov) this.deep.fov = fov;
    else this.flat.zoom = 1 / distance;
    const spherical = new Spherical(fov ? distance : AWAY + this.reach, degToRad(90 - elevation), degToRad(azimuth)).makeSafe();
    this.camera.position.setFromSpherical(spherical).add(this.controls.target);
    this.controls.update();
    this.changed();
  }

  turn(azimuth, elevation) {
    const [a, e] = this.angles;
    this.set({azimuth: a + azimuth, elevation: MathUtils.clamp(e + elevation, -90, 90)});
  }

  zoom(factor) {
    this.set({distance: this.distance * factor});
  }

  /** Moves what is seen by shares of the picture's height. */
  pan(right, up) {
    const height = 2 * this.distance * (this.isDeep ? Math.tan(degToRad(this.deep.fov) / 2) : 1), {camera, controls} = this;
    const move = new Vector3(-right * height, -up * height, 0).applyQuaternion(camera.quaternion);
    camera.position.add(move);
    controls.target.add(move);
    controls.update();
    this.changed();
  }

  /** Looks along a direction. */
  look([x, y, z]) {
    const {theta, phi} = new Spherical().setFromVector3(new Vector3(x, y, z));
    this.set({azimuth: radToDeg(theta), elevation: 90 - radToDeg(phi)});
  }

  /** With and without perspective; what is around the target stays as large as it is. */
  switchProjection() {
    const slope = Math.tan(degToRad(this.deep.fov) / 2);
    if (this.isDeep) this.set({distance: this.distance * slope, fov: 0});
    else this.set({distance: this.distance / slope, fov: this.deep.fov});
  }

  /** Frames parts {points: [M * 3], matrix: to the scene} by the box that they project to. */
  fit(parts) {
    const [azimuth, elevation] = this.angles, aspect = this.size[0] / this.size[1], slope = Math.tan(degToRad(this.deep.fov) / 2);
    this.camera.updateMatrixWorld();
    const axes = [0, 1, 2].map((axis) => new Vector3().setFromMatrixColumn(this.camera.matrixWorld, axis)), place = new Vector3();
    const each = (take) => parts.forEach(({points, matrix}) => {
      for (let i = 0; i < points.length; i += 3) {
        place.fromArray(points, i).applyMatrix4(matrix);
        take(axes.map((axis) => axis.dot(place)));
      }
    });
    const box = new Box3();
    each((xyz) => box.expandByPoint(new Vector3(...xyz)));
    const middle = box.isEmpty() ? new Vector3() : box.getCenter(new Vector3()), [wide, high] = box.getSize(new Vector3()).toArray();
    let distance = this.isDeep ? NEAREST : MARGIN * Math.max(high, wide / aspect) / 2;
    if (this.isDeep) each(([x, y, z]) => {
      distance = Math.max(distance, z - middle.z + NEAREST + MARGIN * Math.max(Math.abs(y - middle.y), Math.abs(x - middle.x) / aspect) / slope);
    });
    this.controls.target.set(0, 0, 0).addScaledVector(axes[0], middle.x).addScaledVector(axes[1], middle.y).addScaledVector(axes[2], middle.z);
    this.set({azimuth, elevation, distance: distance > 0 ? distance : 1});
    this.fitted = this.place;
  }

  /** Where the target is and how far away, as text. */
  get place() {
    return [this.distance, ...this.controls.target.toArray()].map((v) => v.toFixed(6)).join();
  }

  /** Whether nobody has moved or zoomed since the last fit. */
  get isFitted() {
    return this.fitted === this.place;
  }
}
