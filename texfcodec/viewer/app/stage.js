// Two assets, one camera, one light, and what of them is on the canvas.

import {
  Color, DataTexture, DirectionalLight, EquirectangularReflectionMapping, FloatType, FramebufferTexture, LinearFilter,
  LinearSRGBColorSpace, Matrix4, Mesh, NoToneMapping, OrthographicCamera, PlaneGeometry, PMREMGenerator, RGBAFormat, Scene, ShaderMaterial,
  Vector2, WebGLRenderer,
} from 'three';

import {dress} from './shown_layers.js';

export const HOTTEST = 32; // coded levels (root mean square of R, G, B) from which on the heat map is at its hottest
export const HEAT = [[0, 0, 0], [70, 15, 110], [190, 50, 85], [250, 150, 30], [255, 255, 190]]; // from nothing to the hottest
export const ONLY_ONE = [0, 160, 170]; // where one of the two shows nothing
const APART = 3; // radii of one that hold all of the other
const SKY = 256; // rows of the sky's map
const glslColour = (rgb) => `vec3(${rgb.map((v) => (v / 255).toFixed(5))})`;
const DIFFERENCE = `
uniform sampler2D first, second;
uniform float hottest;
vec3 heat(float t) {
  vec3 ramp[5] = vec3[](${HEAT.map(glslColour)});
  float place = clamp(t, 0.0, 1.0) * 4.0;
  int low = min(int(place), 3);
  return mix(ramp[low], ramp[low + 1], place - float(low));
}
void main() {
  vec4 a = texelFetch(first, ivec2(gl_FragCoord.xy), 0), b = texelFetch(second, ivec2(gl_FragCoord.xy), 0);
  vec3 gap = a.rgb - b.rgb + (b.a - a.a) * 0.5;
  if (a.a == 0.0 && b.a == 0.0) discard;
  gl_FragColor = vec4(a.a == 0.0 || b.a == 0.0 ? ${glslColour(ONLY_ONE)} : heat(sqrt(dot(gap, gap) / 3.0) * 255.0 / hottest), 1.0);
}`;

export class Stage {
  /** light: {powers: of the sky's radiance by the height, lights: [{direction, irradiance}]} (server.about_page). Throws without WebGL2. */
  constructor(canvas, light) {
    this.renderer = new WebGLRenderer({canvas, antialias: true, alpha: true});
    this.renderer.toneMapping = NoToneMapping;
    this.renderer.setClearColor(0, 0);
    Object.assign(this, {light, scene: new Scene(), slots: [null, null]});
    for (const {direction, irradiance} of light.lights) {
      const lamp = new DirectionalLight(new Color().setRGB(...irradiance, LinearSRGBColorSpace), 1);
      lamp.position.set(...direction);
      this.scene.add(lamp);
    }
    const fragmentShader = DIFFERENCE, vertexShader = 'void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }';
    this.difference = new ShaderMaterial({vertexShader, fragmentShader, uniforms: {first: {}, second: {}, hottest: {}}, depthTest: false});
    this.sheet = new Scene().add(new Mesh(new PlaneGeometry(2, 2), this.difference));
    this.sheet.children[0].frustumCulled = false;
  }

  /** The sky as light from everywhere: seconds where no GPU is, so once it is seen; anew after a context was lost. */
  lightUp() {
    const values = new Float32Array(8 * SKY * SKY).fill(1), {powers} = this.light; // 2 SKY columns, all alike
    for (let i = 0; i < SKY; i++) {
      const height = Math.sin(((i + 0.5) / SKY - 0.5) * Math.PI), colour = [0, 1, 2].map((c) => Math.max(0, powers.reduceRight((sum, power) => sum * height + power[c], 0)));
      for (let x = 0; x < 2 * SKY; x++) values.set(colour, 4 * (2 * SKY * i + x));
    }
    const sky = new DataTexture(values, 2 * SKY, SKY, RGBAFormat, FloatType, EquirectangularReflectionMapping);
    Object.assign(sky, {colorSpace: LinearSRGBColorSpace, magFilter: LinearFilter, minFilter: LinearFilter, needsUpdate: true});
    const maker = new PMREMGenerator(this.renderer);
    this.scene.environment?.dispose();
    this.scene.environment = maker.fromEquirectangular(sky).texture;
    maker.dispose();
    sky.dispose();
  }

  /** Puts an asset into slot 0 or 1, and frees what was there. Throws, and leaves it empty, if the device cannot hold it. */
  load(slot, asset) {
    this.slots[slot]?.free();
    this.slots[slot] = null;
    asset.check(this.renderer.capabilities.maxTextureSize);
    this.slots[slot] = asset;
    this.scene.add(asset.root);
    const [first] = this.assets, home = first.sphere;
    for (const other of this.assets) other.place(this.apart ? other.sphere : home);
    this.scene.updateMatrixWorld(true);
  }

  get assets() {
    return this.slots.filter(Boolean);
  }

  /** Whether there are two that are no versions of one thing: they are in different places, or of different sizes. */
  get apart() {
    const [first, other] = this.assets.map(({sphere}) => sphere);
    if (!other) return false;
    const gap = first.center.distanceTo(other.center);
    return Math.max((gap + other.radius) / first.radius, (gap + first.radius) / other.radius) > APART;
  }

  /** Parts by which a camera is fitted, of slots. */
  parts(slots = [0, 1]) {
    return slots.filter((slot) => this.slots[slot]).map((slot) => ({points: this.slots[slot].points, matrix: this.slots[slot].root.matrixWorld}));
  }

  /** Radius about 0 0 0 in which everything is. */
  get reach() {
    return Math.max(1, ...this.assets.map(({sphere, root}) => {
      const {center, radius} = sphere.clone().applyMatrix4(new Matrix4().copy(root.matrixWorld));
      return center.length() + radius;
    }));
  }

  resize(width, height, density) {
    this.renderer.setPixelRatio(density);
    this.renderer.setSize(width, height, false);
  }

  get size() {
    return this.renderer.getDrawingBufferSize(new Vector2()).toArray();
  }

  /** Slots that a mode shows, of those that hold something. */
  shownIn(mode) {
    const filled = [0, 1].filter((slot) => this.slots[slot]);
    return filled.length < 2 ? filled : {single: [0], other: [1]}[mode] ?? filled;
  }

  dress(settings) {
    this.assets.forEach((asset) => dress(asset, settings));
    if (settings.lit && settings.layer === 'picture' && !this.scene.environment && this.assets.some(({isLit}) => isLit)) this.lightUp();
  }

  /** Draws what settings {mode, slider, hottest, layer, lit, without} show. */
  draw(view, settings) {
    const {renderer} = this, [width, height] = renderer.getSize(new Vector2()).toArray(), shown = this.shownIn(settings.mode);
    this.dress(settings);
    const isPair = shown.length > 1, halves = isPair && settings.mode === 'side', line = Math.round(settings.slider * width);
    view.aim([halves ? width / 2 : width, height], this.reach);
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, width, height);
    renderer.clear();
    if (isPair && settings.mode === 'difference') return this.drawDifference(view, settings);
    shown.forEach((slot, n) => {
      const [left, wide] = !isPair ? [0, width] : halves ? [n * width / 2, width / 2] : n ? [line, width - line] : [0, line];
      if (wide <= 0) return;
      renderer.setScissorTest(true);
      renderer.setScissor(left, 0, wide, height);
      if (halves) renderer.setViewport(left, 0, wide, height);
      this.render(slot, view);
    });
    return null;
  }

  render(slot, view) {
    this.slots.forEach((asset, n) => { if (asset) asset.root.visible = n === slot; });
    this.renderer.render(this.scene, view.camera);
  }

  drawDifference(view, {hottest}) {
    const {renderer, difference} = this, [width, height] = this.size;
    ['first', 'second'].forEach((name, slot) => {
      const uniform = difference.uniforms[name], known = uniform.value?.image;
      if (known?.width !== width || known?.height !== height) {
        uniform.value?.dispose();
        uniform.value = new FramebufferTexture(width, height);
      }
      this.render(slot, view);
      renderer.copyFramebufferToTexture(uniform.value);
    });
    difference.uniforms.hottest.value = hottest;
    renderer.clear();
    renderer.render(this.sheet, new OrthographicCamera());
  }

  /** Pixels of a slot's picture, premultiplied RGBA from below. */
  pixels(slot, view) {
    const gl = this.renderer.getContext(), [width, height] = this.size, out = new Uint8Array(4 * width * height);
    this.renderer.setScissorTest(false);
    this.render(slot, view);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return out;
  }

  /** How far both pictures of the settings are apart: psnrOf(). The canvas needs to be drawn again. */
  compare(view, settings) {
    const [width, height] = this.renderer.getSize(new Vector2()).toArray();
    this.dress(settings);
    view.aim([width, height], this.reach);
    this.renderer.setViewport(0, 0, width, height);
    return psnrOf(this.pixels(0, view), this.pixels(1, view));
  }

  /** Waits until all is drawn: a pixel that is read back cannot come earlier. */
  wait() {
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
}

/**
 * How far the second of two pictures (premultiplied bytes, RGBA) is from the first, over the pixels that both cover, on white:
 * {both, only, rgb, channels: [r, g, b]}, PSNR in dB, Infinity where they are equal.
 */
export function psnrOf(first, second) {
  const sums = [0, 0, 0];
  let both = 0, only = 0;
  for (let i = 0; i < first.length; i += 4) {
    const a = first[i + 3], b = second[i + 3];
    if (a === 0 || b === 0) {
      only += a !== b;
      continue;
    }
    both++;
    for (let c = 0; c < 3; c++) sums[c] += (first[i + c] - second[i + c] + b - a) ** 2;
  }
  const decibels = (sum, count) => (count ? 10 * Math.log10((255 ** 2 * count) / sum) : NaN);
  return {both, only, rgb: decibels(sums[0] + sums[1] + sums[2], 3 * both), channels: sums.map((sum) => decibels(sum, both))};
}
