// Writes and reads the .png files that the test of engines needs: 8 bits, rgb or rgba, not interlaced.
import zlib from 'node:zlib';

const table = new Uint32Array(256).map((_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
    return n;
});
const crc = (bytes) => ~bytes.reduce((c, b) => table[(c ^ b) & 255] ^ (c >>> 8), -1) >>> 0;

function chunk(type, data) {
    const out = Buffer.alloc(12 + data.length);
    out.writeUInt32BE(data.length);
    out.write(type, 4, 'latin1');
    data.copy(out, 8);
    out.writeUInt32BE(crc(out.subarray(4, 8 + data.length)), 8 + data.length);
    return out;
}

// pixel(x, y) returns r, g, b, a from 0 to 255
export function encode(width, height, pixel) {
    const rows = Buffer.alloc(height * (1 + 4 * width)), head = Buffer.from([0, 0, 0, 0, 0, 0, 0, 0, 8, 6, 0, 0, 0]);
    for (let y = 0; y < height; y++)
        for (let x = 0; x < width; x++) rows.set(pixel(x, y), y * (1 + 4 * width) + 1 + 4 * x);
    head.writeUInt32BE(width, 0);
    head.writeUInt32BE(height, 4);
    return Buffer.concat([Buffer.from('\x89PNG\r\n\x1a\n', 'latin1'), chunk('IHDR', head),
                          chunk('IDAT', zlib.deflateSync(rows)), chunk('IEND', Buffer.alloc(0))]);
}

function predict(filter, left, above, corner) {
    const p = left + above - corner, a = Math.abs(p - left), b = Math.abs(p - above), c = Math.abs(p - corner);
    return [0, left, above, (left + above) >> 1, a <= b && a <= c ? left : b <= c ? above : corner][filter];
}

// Returns { width, height, channels, data }.
export function decode(file) {
    const width = file.readUInt32BE(16), height = file.readUInt32BE(20), channels = file[25] === 6 ? 4 : 3, parts = [];
    if (file[24] !== 8 || (file[25] !== 2 && file[25] !== 6) || file[28]) throw new Error('an unexpected kind of .png');
    for (let at = 8; at < file.length; at += 12 + file.readUInt32BE(at))
        if (file.toString('latin1', at + 4, at + 8) === 'IDAT')
            parts.push(file.subarray(at + 8, at + 8 + file.readUInt32BE(at)));
    const raw = zlib.inflateSync(Buffer.concat(parts)), row = width * channels, data = Buffer.alloc(height * row);
    for (let y = 0; y < height; y++)
        for (let x = 0; x < row; x++) {
            const at = y * row + x, left = x < channels ? 0 : data[at - channels], above = y ? data[at - row] : 0;
            const corner = y && x >= channels ? data[at - row - channels] : 0;
            data[at] = raw[y * (row + 1) + 1 + x] + predict(raw[y * (row + 1)], left, above, corner);
        }
    return { width, height, channels, data };
}
