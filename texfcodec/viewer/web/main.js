// Where the page begins: reads what it shows, then draws jobs for a program or a scene for a person. In a worker: decodes.

import { decodeForThePage, IS_WORKER } from './decoding.js';
import { Asset } from './draw.js';
import { DeviceError, openContext } from './gl.js';
import { isExported } from './inlined.js';
import { doJob } from './jobs.js';
import { say } from './message.js';
import { Source } from './source.js';
import { Viewer } from './viewer.js';

async function jobsOf() {
  if (isExported()) return [];
  const answer = await fetch('job');
  return answer.status === 200 ? answer.json() : [];
}

/** Does every job and posts its answer, or what went wrong. */
async function doJobs(gl, assets, jobs) {
  for (const [number, job] of jobs.entries()) {
    let answer;
    try {
      answer = await doJob(gl, assets, job);
    } catch (error) {
      answer = new Blob([JSON.stringify({ error: String(error.message ?? error) })], { type: 'application/json' });
    }
    await fetch(`result/${number}`, { method: 'POST', body: answer, headers: { 'Content-Type': answer.type } });
  }
}

async function start() {
  const canvas = document.getElementById('view'), source = await Source.open(), jobs = await jobsOf();
  try {
    canvas.setAttribute('aria-busy', 'true');
    const { headers, problem } = await read(source, jobs.length > 0);
    canvas.removeAttribute('aria-busy');
    const gl = openContext(canvas); // last: until now the browser's process for graphics was starting
    if (jobs.length) await doJobs(gl, headers.map((header) => new Asset(gl, header)), jobs);
    else new Viewer(canvas, gl, headers, source);
    if (problem) say(problem);
  } catch (error) {
    if (!jobs.length) throw error;
    for (let n = 0; n < jobs.length; n++) {
      const body = JSON.stringify({ error: String(error.message ?? error) });
      await fetch(`result/${n}`, { method: 'POST', body, headers: { 'Content-Type': 'application/json' } });
    }
  }
}

/** Headers of what the page shows; of what is no sound stream a person is told why, and can drop another. */
async function read(source, isForProgram) {
  if (source.about.names.length && !isForProgram) say(`${source.about.names.join(' and ')}: being decoded …`);
  try {
    const headers = await source.headers();
    if (!isForProgram) say('');
    return { headers, problem: '' };
  } catch (error) {
    if (isForProgram) throw error;
    return { headers: [], problem: `${source.about.names.join(' and ')}: ${error.message}` };
  }
}

if (IS_WORKER) {
  decodeForThePage();
} else {
  start().catch((error) => {
    say(error instanceof DeviceError ? error.message : `The page cannot be shown: ${error.message ?? error}`);
  });
}
