// Runs the Khronos glTF validator on the files named on the command line.
// Prints one JSON object a line; exit code 1 if any file has errors or warnings. A file that was made from
// another is named MADE<SOURCE: it may keep the warnings its source has.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

async function issues(file) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 0 });
  return report.issues;
}

let bad = false;
for (const word of process.argv.slice(2)) {
  const [file, source] = word.split("<");
  const inherited = new Set(source ? (await issues(source)).messages.filter(m => m.severity === 1).map(m => m.code) : []);
  const { numErrors, numInfos, numHints, messages } = await issues(file);
  const warnings = messages.filter(m => m.severity === 1);
  const own = warnings.filter(m => !inherited.has(m.code));
  const shown = messages.filter(m => m.severity < 2 && !inherited.has(m.code)).slice(0, 10);
  console.log(JSON.stringify({ file, numErrors, ownWarnings: own.length, inheritedWarnings: warnings.length - own.length, numInfos, numHints, messages: shown }));
  bad ||= numErrors + own.length > 0;
}
process.exitCode = bad ? 1 : 0;
