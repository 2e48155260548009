// Cameras as render/camera.py has them, in radii from the centre of the first asset's bounding sphere.

export const VIEWS = {
  front: [0, 0, 1], back: [0, 0, -1], left: [-1, 0, 0], right: [1, 0, 0], top: [0, 1, 0], bottom: [0, -1, 0],
};
const ALONG_Y = 1e-9, DEGREE = Math.PI / 180;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, s) => a.map((v) => v * s);
const plus = (a, b) => a.map((v, i) => v + b[i]);

/** Unit direction of angles in degrees: azimuth 0 is the front (+z), 90 the right (+x); elevation 90 is the top (+y). */
export function directionOf(azimuth, elevation) {
  const [a, e] = [azimuth * DEGREE, elevation * DEGREE];
  return [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)];
}

/** Angles [azimuth, elevation] of a direction. */
export function anglesOf(direction) {
  const [x, y, z] = scaled(direction, 1 / Math.hypot(...direction));
  return [Math.atan2(x, z) / DEGREE, Math.asin(Math.min(1, Math.max(-1, y))) / DEGREE];
}

/** Distance, in radii, from which a perspective camera sees the whole sphere. */
export function distanceAround(fov, width, height) {
  const narrow = Math.atan((Math.tan((fov * DEGREE) / 2) * Math.min(width, height)) / height);
  return 1 / Math.sin(narrow);
}

/**
 * What the user turns: azimuth, elevation, degrees; distance, radii (half the visible height of an orthographic view); target,
 * radii; fov: vertical, degrees, 0 for an orthographic view.
 */
export class Orbit {
  constructor({ azimuth = 0, elevation = 0, distance = 1, target = [0, 0, 0], fov = 0 } = {}) {
    Object.assign(this, { azimuth, elevation, distance, target, fov });
  }

  /** Of a job's camera: { direction, perspective } around the whole sphere, or { link }. */
  static of(camera, width, height) {
    if (camera.link) return Orbit.fromLink(camera.link);
    const [azimuth, elevation] = anglesOf(camera.direction), fov = camera.perspective ?? 0;
    const distance = fov ? distanceAround(fov, width, height) : height / Math.min(width, height);
    const orbit = new Orbit({ azimuth, elevation, fov, distance });
    orbit.exact = camera.direction;
    return orbit;
  }

  static fromLink(text) {
    const numbers = text.split(',').map(Number);
    if (numbers.length !== 7 || !numbers.every(Number.isFinite) || !(numbers[2] > 0) || !(numbers[6] >= 0 && numbers[6] < 180)) {
      throw new Error(`${text} is no camera: azimuth,elevation,distance,x,y,z,fov`);
    }
    const [azimuth, elevation, distance, x, y, z, fov] = numbers;
    return new Orbit({ azimuth, elevation, distance, target: [x, y, z], fov });
  }

  get link() {
    return [this.azimuth, this.elevation, this.distance, ...this.target, this.fov].map((v) => +v.toFixed(5)).join(',');
  }

  turn(azimuth, elevation) {
    this.exact = null;
    this.azimuth = ((this.azimuth + azimuth + 540) % 360) - 180;
    this.elevation = Math.min(90, Math.max(-90, this.elevation + elevation));
  }

  zoom(factor) {
    this.distance = Math.min(1e3, Math.max(1e-3, this.distance * factor));
  }

  /** Moves the target so that what is seen moves by shares of the picture's height. */
  pan(right, up) {
    const axes = this.axes(), size = 2 * this.distance * (this.fov ? Math.tan((this.fov * DEGREE) / 2) : 1);
    this.target = plus(this.target, plus(scaled(axes.right, -right * size), scaled(axes.up, -up * size)));
  }

  axes() {
    const direction = this.exact ? scaled(this.exact, 1 / Math.hypot(...this.exact)) : directionOf(this.azimuth, this.elevation);
    const forward = scaled(direction, -1);
    const upwards = Math.hypot(direction[0], direction[2]) < ALONG_Y ? [0, 0, 1] : [0, 1, 0];
    const right = cross(forward, upwards), unit = scaled(right, 1 / Math.hypot(...right));
    return { right: unit, up: cross(unit, forward), forward };
  }

  /**
   * What shaders take for a picture of a size: matrix (16 numbers by column), eye, forward, pixel (its side in radii, at depth 1
   * when perspective), perspective. reach: radius in which everything is that may be seen.
   */
  camera(width, height, reach = 1) {
    const { right, up, forward } = this.axes(), perspective = this.fov > 0;
    const half = perspective ? Math.tan((this.fov * DEGREE) / 2) : this.distance;
    const back = perspective ? this.distance : Math.hypot(...this.target) + reach + this.distance;
    const eye = plus(this.target, scaled(forward, -back)), middle = dot(scaled(eye, -1), forward);
    const far = middle + 1.01 * reach, before = middle - 1.01 * reach;
    const near = perspective ? Math.max(before, 1e-3 * Math.max(far, 1e-6)) : before;
    const pixel = (2 * half) / height, wide = (half * width) / height;
    const rows = [
      [...scaled(right, 1 / wide), -dot(right, eye) / wide], [...scaled(up, 1 / half), -dot(up, eye) / half],
      depthRow(forward, eye, near, far, perspective), perspective ? [...forward, -dot(forward, eye)] : [0, 0, 0, 1],
    ];
    const matrix = [0, 1, 2, 3].flatMap((column) => rows.map((row) => row[column]));
    return { matrix, eye, forward, pixel, perspective, width, height };
  }
}

/** The row of clip space's z: -w at near, w at far. */
function depthRow(forward, eye, near, far, perspective) {
  const depth = [...forward, -dot(forward, eye)], span = far - near;
  if (!perspective) return [...scaled(depth, 2 / span).slice(0, 3), (2 * depth[3] - far - near) / span];
  return [...scaled(depth, (far + near) / span).slice(0, 3), (depth[3] * (far + near) - 2 * far * near) / span];
}
