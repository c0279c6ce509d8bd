
// Makes the page out of what lies in it as text (src/pack.rs).

// Groups of 7 UTF-16 units hold 111 bits: the upper 5 bits of each are a digit of base 29, the lower 11 are as they are.
function bytesOf(element) {
  const text = element.textContent;
  const length = Number(element.dataset.length);
  const out = new Uint8Array(length);
  let [at, value, held] = [0, 0, 0];
  const put = (bits, count) => {
    value = (value << count) | bits;
    for (held += count; held >= 8; at += 1) {
      held -= 8;
      out[at] = value >> held;
    }
    value &= 255;
  };
  for (let i = 0; i < text.length; i += 7) {
    let number = 0;
    for (let k = i; k < i + 7; k += 1) {
      const upper = text.charCodeAt(k) >> 11;
      number = number * 29 + upper - (upper > 27 ? 2 : 1);
    }
    put(Math.floor(number / 0x20000), 17);
    put(number % 0x20000, 17);
    for (let k = i; k < i + 7; k += 1) put(text.charCodeAt(k) & 0x7ff, 11);
  }
  return out;
}

// The bytes in an element, inflated (RFC 1950), which checks their sum.
async function unpacked(id) {
  if (!window.DecompressionStream) throw new Error("this browser is too old");
  try {
    const stream = new Blob([bytesOf(document.getElementById(id))]).stream();
    return await new Response(stream.pipeThrough(new DecompressionStream("deflate"))).blob();
  } catch {
    throw new Error("it is damaged. It must be passed on whole, as a file");
  }
}

try {
  const body = new Uint8Array(await (await unpacked("bytes")).arrayBuffer());
  const end = body.length - 4;
  const first = end - new DataView(body.buffer).getUint32(end, true);
  const text = bytes => new TextDecoder().decode(bytes);
  const page = JSON.parse(text(body.subarray(first, end)));
  const part = ([at, length]) => body.subarray(at, at + length);
  const add = (name, what) => document.head.append(Object.assign(document.createElement(name), what));
  document.body.insertAdjacentHTML("afterbegin", text(part(page.markup)));
  add("style", { textContent: text(part(page.style)) });
  window.handcastPage = { page, part, clip: () => unpacked("clip-bytes") };
  add("script", { type: "module", textContent: text(part(page.script)) });
} catch (error) {
  const words = Object.assign(document.createElement("p"), { textContent: `This page cannot be shown: ${error.message}.` });
  words.setAttribute("role", "alert");
  document.body.replaceChildren(words);
}
