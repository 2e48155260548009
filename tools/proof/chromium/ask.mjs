// A decoder's command, as conformance/run.py calls one: hands the stream to the browser of vectors.mjs, at the address in $TEXF_ASK.

import { mkdirSync, writeFileSync } from 'node:fs';
import path from 'node:path';

const [stream, folder, ...rest] = process.argv.slice(2), level = rest[0] === '--lod' ? Number(rest[1]) : 0;
const response = await fetch(process.env.TEXF_ASK, { method: 'POST', body: JSON.stringify({ stream: path.resolve(stream), level }) });
const { code, files, message } = await response.json();
mkdirSync(folder, { recursive: true });
for (const [name, content] of Object.entries(files)) writeFileSync(path.join(folder, `${name}.bin`), Buffer.from(content, 'base64'));
if (message) console.error(message);
process.exitCode = code;
