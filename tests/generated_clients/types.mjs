// Writes types.d.ts with openapi-typescript, which takes uploaded files for text unless it is told otherwise.
import { readFileSync, writeFileSync } from "node:fs";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const blob = ts.factory.createTypeReferenceNode("Blob");
const transform = (schema) => (schema.format === "binary" ? blob : undefined);
writeFileSync("types.d.ts", astToString(await openapiTS(JSON.parse(readFileSync("openapi.json", "utf8")), { transform })));
