// What a program asks of the page: pictures as PNG, numbers as bytes. Each kind is a function of the context, assets and the job.

import { Orbit } from './camera.js';
import { drawCaptions } from './captions.js';
import { Painter, SCREEN } from './draw.js';
import { Program, tableTexture, Target } from './gl.js';
import { hasLayer, layersOf, needsLight } from './look.js';
import { HOTTEST, Presenter } from './present.js';

/** A Blob with the answer of a job. */
export async function doJob(gl, assets, job) {
  const kinds = { picture, network: probeNetwork, times, compile };
  if (!(job.kind in kinds)) throw new Error(`there is no job of kind ${job.kind}`);
  const answer = await kinds[job.kind](gl, assets, job);
  if (gl.getError() === gl.CONTEXT_LOST_WEBGL) throw new Error('the graphics context was lost');
  return answer;
}

function json(value) {
  return new Blob([JSON.stringify(value)], { type: 'application/json' });
}

function optionsOf(job) {
  return { lit: Boolean(job.shaded), layer: job.layer ?? 'picture', effects: job.effects ?? 'scene', without: job.without ?? [] };
}

function checkLayer(headers, layer) {
  if (headers.some((header) => hasLayer(header, layer))) return;
  const names = Object.values(layersOf(headers)).flat().map(([key]) => key);
  throw new Error(`there is no layer ${layer}; there are ${names.join(', ')}`);
}

/** Targets with the pictures of the assets that a job names. */
function drawn(gl, assets, job) {
  const shown = job.mode && job.mode !== 'single' ? assets : [assets[job.asset ?? 0]];
  checkLayer(shown.map((asset) => asset.header), job.layer ?? 'picture');
  const [width, height] = job.size, home = shown[0].header, painter = new Painter(gl);
  const wide = job.mode === 'side' ? Math.max(1, width >> 1) : width;
  const reach = Math.max(...shown.map((asset) => asset.reachIn(home)));
  const camera = Orbit.of(job.camera, wide, height).camera(wide, height, reach);
  const options = optionsOf({ ...job, shaded: job.shaded === null ? needsLight(home) : job.shaded });
  return shown.map((asset) => {
    const target = new Target(gl, wide, height);
    painter.draw(asset, camera, target, options, home);
    return target;
  });
}

async function picture(gl, assets, job) {
  const times = job.anti_alias ?? 1, [width, height] = job.size.map((side) => side * times);
  const targets = drawn(gl, assets, { ...job, size: [width, height] }), sheet = new Target(gl, width, height);
  sheet.bind();
  new Presenter(gl).show(targets[0], targets[1], { ...job, mode: job.mode ?? 'single', width, height });
  const named = job.captions ? assets.map((asset) => asset.header) : [];
  const png = await pngOf(sheet, times, (context) => drawCaptions(context, named, { hottest: HOTTEST, ...job }));
  [...targets, sheet].forEach((one) => one.free());
  return png;
}

/** A target as a PNG, each pixel the rounded mean of times x times of its; write: puts on its 2D context what stands over it. */
async function pngOf(target, times, write) {
  const [width, height] = [target.width / times, target.height / times], pixels = target.read();
  const image = new ImageData(width, height), canvas = document.createElement('canvas');
  const sums = new Float64Array(width * height * 4);
  for (let row = 0; row < target.height; row++) {
    const to = (height - 1 - Math.floor(row / times)) * width;
    for (let i = 0; i < 4 * target.width; i++) {
      sums[4 * (to + Math.floor((i >> 2) / times)) + (i & 3)] += pixels[4 * row * target.width + i];
    }
  }
  image.data.set(sums.map((sum) => Math.floor(sum / times ** 2 + 0.5)));
  Object.assign(canvas, { width, height });
  const context = canvas.getContext('2d');
  context.putImageData(image, 0, 0);
  write(context);
  return new Promise((done) => { canvas.toBlob(done, 'image/png'); });
}

/** What the network of field job.field answers at job.positions, flat integers of 24 bits: float32 on 0..255, four a place. */
function probeNetwork(gl, assets, job) {
  const field = assets[0].fields[job.field ?? 0], count = job.positions.length / 3;
  const width = 1024, height = Math.ceil(count / width);
  const places = new Uint32Array(4 * count);
  for (let i = 0; i < count; i++) places.set(job.positions.slice(3 * i, 3 * i + 3), 4 * i);
  const outputs = Math.ceil(assets[0].header.payload.widths.at(-1) / 4);
  const names = [...Array(outputs).keys()].map((n) => `n${n}`).join(', ');
  const program = new Program(gl, SCREEN, `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D u_positions;
out vec4 o_colour;
vec3 v_position = vec3(0.0);
ivec2 place(int i) { return ivec2(i & 2047, i >> 11); }
${field.probeSource()}
void main() {
  int i = int(gl_FragCoord.y) * ${width} + int(gl_FragCoord.x);
  uvec2 xy = texelFetch(u_positions, place(2 * i), 0).rg, z = texelFetch(u_positions, place(2 * i + 1), 0).rg;
  vec4 ${names};
  network(ivec3(ivec2(xy), int(z.x)), ${names});
  o_colour = 255.0 * n${job.output ?? 0};
}`);
  if (!gl.getExtension('EXT_color_buffer_float')) throw new Error('this device does not draw into floats');
  const target = new Target(gl, width, height, 'rgba32f');
  gl.useProgram(program.handle);
  target.bind();
  gl.disable(gl.DEPTH_TEST);
  gl.disable(gl.BLEND);
  gl.disable(gl.CULL_FACE);
  program.texture('u_positions', tableTexture(gl, 'rg32ui', places, 'The places'), 0);
  field.network.bind(program, 1);
  gl.bindVertexArray(null);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  return new Blob([target.read(true).subarray(0, 4 * count)], { type: 'application/octet-stream' });
}

/** Milliseconds a frame of a view, and with each of job.leave_out left out: { frame, without: { effect: ms } }. */
function times(gl, assets, job) {
  const [width, height] = job.size, asset = assets[job.asset ?? 0];
  const painter = new Painter(gl), target = new Target(gl, width, height);
  const camera = Orbit.of(job.camera, width, height).camera(width, height);
  const drawAll = (without) => painter.draw(asset, camera, target, { ...optionsOf(job), without });
  const measured = (without) => frameTime(gl, () => drawAll(without), target, job.frames);
  const frame = measured([]), without = Object.fromEntries((job.leave_out ?? []).map((name) => [name, measured([name])]));
  return json({ frame, without, resident: asset.bytes, renderer: rendererOf(gl) });
}

/** The least of the milliseconds that several frames take, read back. */
export function frameTime(gl, draw, target, frames = 5) {
  const seconds = [], pixel = new Uint8Array(4);
  for (let n = 0; n <= frames; n++) {
    const begin = performance.now();
    draw();
    target.bind();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    if (n > 0) seconds.push(performance.now() - begin); // the first compiles
  }
  return Math.min(...seconds);
}

/** What draws: the name of the device or of the software. */
export function rendererOf(gl) {
  const told = gl.getExtension('WEBGL_debug_renderer_info');
  return gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}

/** Compiles every program that an asset's parts call for, with all layers that are asked: [{ key, milliseconds }]. */
function compile(gl, assets, job) {
  const found = [];
  for (const asset of assets) {
    for (const layer of job.layers ?? ['picture']) {
      for (const [, , number, m] of asset.header.mesh.parts) {
        const begin = performance.now(), known = asset.programs.size;
        const material = asset.header.materials[m], options = optionsOf({ ...job, layer });
        asset.program(asset.fields[number], material, { ...options, peels: material.alpha_mode === 2 ? 2 : 0 });
        if (asset.programs.size > known) {
          const { kind } = asset.fields[number].told;
          const milliseconds = performance.now() - begin;
          found.push({ asset: asset.header.name, kind, layer, effects: material.effects, milliseconds });
        }
      }
    }
  }
  return json(found);
}
