// Writes the types of the API, for the OpenAPI document at standard input, with openapi-typescript, which takes uploaded files for
// text unless it is told otherwise.
import { json } from "node:stream/consumers";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const blob = ts.factory.createTypeReferenceNode("Blob");
const transform = (schema) => (schema.format === "binary" ? blob : undefined);
process.stdout.write(astToString(await openapiTS(await json(process.stdin), { transform })));
