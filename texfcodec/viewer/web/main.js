// Where the page begins: fetches what it shows, then draws jobs for a program or a scene for a person.

import { unpack } from './data.js';
import { Asset } from './draw.js';
import { DeviceError, openContext } from './gl.js';
import { inlinedAbout, inlinedContainer, isExported } from './inlined.js';
import { doJob } from './jobs.js';
import { say } from './message.js';
import { Viewer } from './viewer.js';

async function answerOf(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path} answers ${answer.status}`);
  return answer;
}

async function aboutPage() {
  return isExported() ? inlinedAbout() : (await answerOf('about')).json();
}

async function containerOf(number) {
  return isExported() ? inlinedContainer(number) : (await answerOf(`asset/${number}`)).arrayBuffer();
}

async function jobsOf() {
  if (isExported()) return [];
  const answer = await answerOf('job');
  return answer.status === 204 ? [] : answer.json();
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
  const canvas = document.getElementById('view'), about = await aboutPage(), jobs = await jobsOf();
  try {
    const headers = [];
    for (let n = 0; n < about.assets; n++) headers.push(unpack(await containerOf(n)));
    const gl = openContext(canvas); // last: until now the browser's process for graphics was starting
    if (jobs.length) await doJobs(gl, headers.map((header) => new Asset(gl, header)), jobs);
    else new Viewer(canvas, gl, headers, about);
  } catch (error) {
    if (!jobs.length) throw error;
    for (let n = 0; n < jobs.length; n++) {
      const body = JSON.stringify({ error: String(error.message ?? error) });
      await fetch(`result/${n}`, { method: 'POST', body, headers: { 'Content-Type': 'application/json' } });
    }
  }
}

start().catch((error) => {
  say(error instanceof DeviceError ? error.message : `The page cannot be shown: ${error.message ?? error}`);
});
