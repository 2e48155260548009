// What a frame costs, with and without each term of shading.

import { Target } from './gl.js';
import { frameTime } from './jobs.js';

const PIXELS = 512 ** 2; // of a frame whose time is measured, at most
const FRAMES = 3;

/**
 * Milliseconds of frames of what a viewer shows, in light: { size, frame, all: with all terms that there are }, and, as they
 * come, told(name, milliseconds) of a frame without each of some terms.
 */
export async function measureTerms(viewer, names, told) {
  const { stage, orbit, gl, look } = viewer, slot = stage.shownIn(look.mode)[0], [wide, high] = viewer.size;
  const share = Math.min(1, Math.sqrt(PIXELS / (wide * high)));
  const size = [wide, high].map((length) => Math.max(1, Math.round(length * share))), target = new Target(gl, ...size);
  const time = async (changes) => {
    await new Promise((done) => { setTimeout(done, 0); }); // so that the page shows what was told
    const own = { mode: 'single', lit: true, effects: 'scene', without: [], layerOf: () => 'picture', ...changes };
    const wish = stage.wish(slot, orbit, size, own, 1);
    return frameTime(gl, () => stage.painter.draw(wish.asset, wish.camera, target, wish.options, wish.home), target, FRAMES);
  };
  try {
    const frame = await time({});
    for (const name of names) told(name, await time({ without: [name] }));
    return { size, frame, all: await time({ effects: 'all' }) };
  } finally {
    target.free();
  }
}
