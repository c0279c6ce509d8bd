// Runs the Khronos glTF validator on the files named on the command line.
// Prints one JSON object a line; exit code 1 if any file has errors or warnings.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

let bad = false;
for (const file of process.argv.slice(2)) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 100 });
  const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
  console.log(JSON.stringify({ file, numErrors, numWarnings, numInfos, numHints, messages: messages.slice(0, 10) }));
  bad ||= numErrors + numWarnings > 0;
}
process.exitCode = bad ? 1 : 0;
