// show.mjs BAKED THREE PICTURE CHROMIUM: serves the folder BAKED and three.js to a headless Chromium on this machine,
// which draws page.html, and saves its screenshot as PICTURE. Prints what the page said. Exit status 1 if it failed.
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import { spawn } from 'node:child_process';

const [baked, three, picture, chromium] = process.argv.slice(2), here = import.meta.dirname;
const folders = { baked, three, engines: path.join(here, '../../examples/engines') };
const types = { '.js': 'text/javascript', '.html': 'text/html', '.png': 'image/png' };
const said = [];

const server = http.createServer((request, response) => {
    const name = decodeURIComponent(request.url.split('?')[0]), [, first, ...rest] = name.split('/');
    const file = name === '/' ? path.join(here, 'page.html') : path.join(folders[first] ?? '/none', ...rest);
    if (name === '/said') {
        let text = '';
        request.on('data', (part) => { text += part; });
        request.on('end', () => { said.push(text); response.end(); });
    } else
        fs.readFile(file, (error, bytes) => {
            response.writeHead(error ? 404 : 200,
                               { 'Content-Type': types[path.extname(file)] ?? 'application/octet-stream' });
            response.end(bytes);
        });
}).listen(0, '127.0.0.1', show);

// Chromium's own protocol over pipes: messages of JSON that end with a zero byte.
function show() {
    const browser = spawn(chromium, [
        '--headless', '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--hide-scrollbars',
        '--force-color-profile=srgb', '--window-size=240,1260', '--remote-debugging-pipe',
        `--user-data-dir=${picture}.profile`, 'about:blank'
    ], { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'], detached: true });
    const waiting = new Map(), end = (code) => {
        try { process.kill(-browser.pid, 'SIGKILL'); } catch { /* it has ended */ }
        fs.rmSync(`${picture}.profile`, { recursive: true, force: true, maxRetries: 5, retryDelay: 100 });
        console.log(said.join('\n'));
        process.exit(code);
    };
    const send = (method, params, session) => new Promise((resolve, reject) => {
        const id = waiting.size + 1;
        waiting.set(id, { resolve, reject });
        browser.stdio[3].write(JSON.stringify({ id, method, params, sessionId: session }) + '\0');
    });
    let text = '';
    browser.stdio[4].on('data', (part) => {
        const messages = (text + part).split('\0');
        text = messages.pop();
        for (const { id, result, error } of messages.map((m) => JSON.parse(m)))
            if (error) waiting.get(id)?.reject(new Error(error.message)); else waiting.get(id)?.resolve(result);
    });
    browser.on('error', (error) => { said.push(error.message); end(1); });
    setTimeout(() => { said.push('chromium does not answer'); end(1); }, 120000);
    draw(send).then(() => end(said.join() === 'done' ? 0 : 1), (error) => { said.push(error.message); end(1); });
}

async function draw(send) {
    const { targetId } = await send('Target.createTarget', { url: `http://127.0.0.1:${server.address().port}/` });
    const { sessionId } = await send('Target.attachToTarget', { targetId, flatten: true });
    for (let i = 0; i < 1200 && !said.length; i++) await new Promise((passed) => setTimeout(passed, 100));
    if (!said.length) throw new Error('the page did not end');
    const { data } = await send('Page.captureScreenshot', { format: 'png' }, sessionId);
    fs.writeFileSync(picture, Buffer.from(data, 'base64'));
}
