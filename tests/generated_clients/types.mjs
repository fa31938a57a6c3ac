// Writes the types of the API, for the OpenAPI document at standard input, with openapi-typescript. Unless it is told otherwise, it
// takes uploaded files for text, and points for lists of any length.
import { json } from "node:stream/consumers";
import openapiTS, { astToString } from "openapi-typescript";
import ts from "typescript";

const { factory, SyntaxKind } = ts;
const number = factory.createKeywordTypeNode(SyntaxKind.NumberKeyword);

function transform({ format, type, items, minItems, maxItems }) {
  if (format === "binary") return factory.createTypeReferenceNode("Blob");
  if (type === "array" && items.type === "number" && minItems > 0 && minItems === maxItems) return factory.createTupleTypeNode(Array(minItems).fill(number));
  return undefined;
}

process.stdout.write(astToString(await openapiTS(await json(process.stdin), { transform })));
