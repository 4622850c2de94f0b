// The operator of this browser. In signed mode the key stays here, in IndexedDB, and cannot be exported: the desk
// passes on signed commands, and cannot sign itself.

import { Bundle, Operator, fingerprint, requestText } from "./proof.js";

const DATABASE = "cruiser";
const STORE = "operator";

function store(mode, act) {
  return new Promise((resolve, reject) => {
    const opening = indexedDB.open(DATABASE, 1);
    opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
    opening.onerror = () => reject(opening.error);
    opening.onsuccess = () => {
      const request = act(opening.result.transaction(STORE, mode).objectStore(STORE));
      request.onsuccess = () => {
        opening.result.close();
        resolve(request.result);
      };
      request.onerror = () => reject(request.error);
    };
  });
}

const read = (name) => store("readonly", (objects) => objects.get(name));
const write = (name, value) => store("readwrite", (objects) => objects.put(value, name));

const hex = (bytes) => Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");

/** The public half of this browser's key, hexadecimal; made and stored if there is none. */
export async function publicKey() {
  let pair = await read("pair");
  if (pair === undefined) {
    pair = await crypto.subtle.generateKey("Ed25519", false, ["sign", "verify"]);
    await write("pair", pair);
  }
  return hex(new Uint8Array(await crypto.subtle.exportKey("raw", pair.publicKey)));
}

/**
 * A request for a grant, as `cruiser provision sign` reads it, and its fingerprint. It asks for no certificate: the desk
 * has one.
 */
export async function requestFor(name) {
  const key = await publicKey();
  const { privateKey } = await read("pair");
  const text = requestText("operator", [name], key, "");
  const proof = hex(new Uint8Array(await crypto.subtle.sign("Ed25519", privateKey, text)));
  const request = { version: 2, role: "operator", names: [name], csr: "", key, proof };
  return [JSON.stringify(request), await fingerprint(text)];
}

/** The authority's bundle, if it is for this browser's key, and the fingerprint of its request. */
export async function answerOf(text) {
  const bundle = await Bundle.read(text);
  if (bundle.key !== (await publicKey())) throw new Error("this bundle is for another key");
  return [bundle, await fingerprint(requestText("operator", [bundle.name], bundle.key, ""))];
}

/** Was the fingerprint of this authority compared here? */
export async function isKnown(bundle) {
  return (await read("grant"))?.fingerprint === bundle.fingerprint;
}

/** Accept the authority's bundle. */
export const install = ({ statement, authority, fingerprint }) => write("grant", { chain: statement, authority, fingerprint });

/** The operator with key and grant; null in open mode. */
export async function signer() {
  const [pair, grant] = [await read("pair"), await read("grant")];
  if (pair === undefined || grant === undefined) return null;
  return Operator.create(pair.privateKey, grant.chain, grant.authority);
}

/** The rights of the grant by its own text; robots judge by it. */
export const grantOf = (one) => JSON.parse(one.statement.split("\n", 1)[0]);

/** Return to open mode. The key stays, for another bundle. */
export const forget = () => store("readwrite", (objects) => objects.delete("grant"));
