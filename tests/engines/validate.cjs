// validate.cjs MODULES FILE...: checks files by Khronos' validator, which lies in the folder MODULES. Prints errors and
// warnings. Exit status 1 if there are any.
const fs = require('fs'), path = require('path');
const [modules, ...files] = process.argv.slice(2), validator = require(path.resolve(modules, 'gltf-validator'));

(async () => {
    for (const file of files) {
        const read = (name) => Promise.resolve(new Uint8Array(fs.readFileSync(path.join(path.dirname(file), name))));
        const { issues } = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)),
                                                         { externalResourceFunction: read });
        for (const m of issues.messages.filter(({ severity }) => severity < 2)) {
            console.log(`${file}: ${m.code} at ${m.pointer}: ${m.message}`);
            process.exitCode = 1;
        }
    }
})();
