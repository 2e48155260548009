// Where the page begins: it reads what it is to show, and shows it.

import {say} from './dom.js';
import {Source} from './source.js';
import {Viewer} from './viewer.js';

async function start() {
  const canvas = document.getElementById('view'), source = await Source.open(), {assets} = source.about;
  const names = assets.map(({name}) => name).join(' and ');
  const viewer = new Viewer(canvas, source);
  canvas.setAttribute('aria-busy', 'true');
  if (names) say(`${names}: loading …`);
  try {
    const shown = await Promise.all(assets.map((facts, n) => source.held(n).then((data) => source.load(data, facts))));
    say('');
    shown.forEach((asset, slot) => viewer.show(asset, slot));
  } catch (error) {
    say(`${names}: ${error.message}`);
  }
  canvas.removeAttribute('aria-busy');
}

start().catch((error) => say(`The page cannot be shown. ${error.message ?? error}`));
