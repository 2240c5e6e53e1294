// From the text that codec.py wrote to planes of whole numbers.

const ALPHABET =
  "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;/=>?@^_`{|}~";
const CONTEXTS = 10, ONE_MORE = 254, TWO_MORE = 255;
const DIGITS = new Uint8Array(128);
for (let i = 0; i < ALPHABET.length; i++) DIGITS[ALPHABET.charCodeAt(i)] = i;

function bytesOf(text) {
  // Five digits are four bytes; a shorter last group is filled up with the highest digit.
  const length = Math.floor((text.length * 4) / 5);
  const bytes = new Uint8Array(Math.ceil(text.length / 5) * 4);
  for (let i = 0, at = 0; i < text.length; at += 4) {
    let word = 0;
    for (let k = 0; k < 5; k++, i++) word = word * 85 + (i < text.length ? DIGITS[text.charCodeAt(i)] : 84);
    bytes[at] = word / 16777216;
    bytes[at + 1] = word >>> 16;
    bytes[at + 2] = word >>> 8;
    bytes[at + 3] = word;
  }
  return bytes.subarray(0, length);
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The numbers of one plane, row by row.
function numbersOf(body, width, height) {
  const view = new DataView(body.buffer, body.byteOffset);
  const kind = body[0], at = new Uint32Array(CONTEXTS), start = 5 + 4 * CONTEXTS;
  for (let c = 0, sum = start; c < CONTEXTS; c++) {
    at[c] = sum;
    sum += view.getUint32(1 + 4 * c, true);
  }
  let one = start + width * height, two = one + view.getUint32(1 + 4 * CONTEXTS, true);
  const plane = new Int32Array(width * height), row = width + 2;
  let above = new Int32Array(row), here = new Int32Array(row);
  for (let y = 0, i = 0; y < height; y++) {
    here[0] = above[1];
    for (let x = 1; x <= width; x++, i++) {
      const w = here[x - 1], n = above[x], nw = above[x - 1], ne = above[x + 1];
      const differences = Math.abs(w - nw) + Math.abs(n - nw) + Math.abs(n - ne);
      const context = Math.min(32 - Math.clz32(differences), CONTEXTS - 1);
      let value = body[at[context]++];
      if (value === ONE_MORE) value += body[one++];
      else if (value === TWO_MORE) {
        value = ONE_MORE + 256 + body[two] + 256 * body[two + 1];
        two += 2;
      }
      let guess;
      if (kind === 0) {
        const low = Math.min(w, n), high = Math.max(w, n);
        guess = nw >= high ? low : nw <= low ? high : w + n - nw;
      } else if (kind === 1) guess = (2 * (w + n) + ne - nw + 2) >> 2;
      else guess = (w + n + nw + ne + 2) >> 2;
      plane[i] = here[x] = guess + (value & 1 ? -((value + 1) >> 1) : value >> 1);
    }
    here[width + 1] = here[width];
    [above, here] = [here, above];
  }
  return plane;
}

// {channels: [one or three planes], marks: plane or null} of what planes.py packed.
async function decoded(text, channels, width, height) {
  const planes = [];
  for (const part of text.trim().split(" ")) planes.push(numbersOf(await inflated(bytesOf(part)), width, height));
  const marks = planes.length > channels ? planes.pop() : null;
  if (channels === 3) {
    const [green, red, blue] = planes;
    for (let i = 0; i < green.length; i++) {
      red[i] += green[i];
      blue[i] += green[i];
    }
    return { channels: [red, green, blue], marks };
  }
  return { channels: planes, marks };
}
