// SPDX-License-Identifier: Apache-2.0
// Proof of commands to a robot in signed mode, and of what it says. Written from docs/authority.md alone.
//
// WebCrypto alone, no packages: the same file runs in Node.js and in a browser. Keys are CryptoKeys that need not be
// extractable; a browser keeps one in IndexedDB. `npm test` holds it against schemas/vectors/proof.json.

export type Bytes = Uint8Array<ArrayBuffer>;

/** What is sent, and under which names. The encoding is the one of docs/commands.md, whatever Zenoh carried. */
export interface Message {
  key: string;
  encoding: string;
  payload: Uint8Array;
}

const VERSION = 1;
const SIGNATURE_BYTES = 64;
const TAG_BYTES = 16;
const VERB_FIELDS_BYTES = 1 + 8 + 8 + 8; // of a verb's attachment, before the signature
const ROBOT_FIELDS_BYTES = 1 + 8; // of a reply's attachment, before the signature
const DOMAIN = utf8("cruiser-auth-1\0");

/** The text that is signed. No two lists of parts give the same. */
export function signedText(kind: string, ...parts: Uint8Array[]): Bytes {
  return concat(DOMAIN, utf8(kind), ...parts.flatMap((part) => [bigEndian(part.length, 4), part]));
}

/** The text under the proof of a message; `fields` is its attachment up to there. */
export function messageText(kind: string, message: Message, fields: Uint8Array, ...request: Uint8Array[]): Bytes {
  return signedText(kind, utf8(message.key), utf8(message.encoding), fields, message.payload, ...request);
}

/** A key that signs verbs, its grant, and the authority that signs robots. */
export class Operator {
  private constructor(
    private readonly key: CryptoKey,
    private readonly grant: Bytes,
    /** The operator's chunk in the keys of its commands. */
    readonly name: string,
    /** The text of its grant, to be shown to robots. */
    readonly statement: string,
    /** The authority's active public key, hexadecimal. */
    readonly authority: string,
  ) {}

  static async create(key: CryptoKey, statement: string, authority: string): Promise<Operator> {
    const [body = ""] = statement.split("\n", 1);
    return new Operator(key, await statementId(body), JSON.parse(body).name, statement, authority);
  }

  /** The attachment of a verb, 89 bytes. `challenge` is the newest one of `safety/state`. */
  async attach(message: Message, challenge: Uint8Array, nonce = random(8)): Promise<Bytes> {
    const fields = concat(Uint8Array.of(VERSION), this.grant, challenge, nonce);
    const signature = await crypto.subtle.sign("Ed25519", this.key, messageText("S", message, fields));
    return concat(fields, new Uint8Array(signature));
  }
}

/** The key of a robot that was met: what it says is checked with it. */
export class Robot {
  private constructor(private readonly key: string) {}

  /** The robot that proves by its own grant (`own` of its reply) that it has this name. */
  static async ofChain(own: string, name: string, authority: string, nowS = Date.now() / 1000): Promise<Robot> {
    const grant = await grantOf(own, authority, nowS);
    if (grant.role !== "robot" || grant.name !== name) {
      throw new Error(`the grant is of ${grant.role} ${grant.name}, not of robot ${name}`);
    }
    return new Robot(grant.key);
  }

  /** Is it the robot's reply to the request that had this attachment? */
  async isReply(message: Message, attachment: Uint8Array, request: Uint8Array): Promise<boolean> {
    return this.hasSigned("R", message, attachment, request);
  }

  /**
   * Did the robot publish it in this run, the one of its reply on `@auth`? A sample of this run may still be an old one:
   * see isAhead.
   */
  async isPublication(message: Message, attachment: Uint8Array, run: Uint8Array): Promise<boolean> {
    return hex(runOf(attachment)) === hex(run) && this.hasSigned("P", message, attachment);
  }

  private async hasSigned(kind: string, message: Message, attachment: Uint8Array, ...request: Uint8Array[]) {
    if (attachment.length !== ROBOT_FIELDS_BYTES + SIGNATURE_BYTES || attachment[0] !== VERSION) return false;
    const [fields, signature] = [attachment.slice(0, ROBOT_FIELDS_BYTES), attachment.slice(ROBOT_FIELDS_BYTES)];
    return fits(this.key, signature, messageText(kind, message, fields, ...request));
  }
}

/** The run of the gateway that made a reply or a sample, from its attachment. */
export function runOf(attachment: Uint8Array): Uint8Array {
  return attachment.slice(1, ROBOT_FIELDS_BYTES);
}

/** Is this `sequence` after the newest accepted one? It wraps to 0. */
export function isAhead(sequence: number, newest?: number): boolean {
  return newest === undefined || ((sequence - newest) | 0) > 0; // the difference as a signed number of 32 bits
}

/** A request to be let in: the text that its keys sign, and of which its fingerprint is. `key` is hexadecimal. */
export function requestText(role: string, names: string[], key: string, csr: string): Bytes {
  return signedText("A", utf8("request-2"), utf8(role), hexBytes(key), utf8(csr), ...names.map(utf8));
}

/** What people compare by voice, of a request or an authority: the first half of a SHA-256, in groups. */
export async function fingerprint(text: Bytes): Promise<string> {
  return hex((await sha256(text)).slice(0, 16)).replace(/(.{4})(?=.)/g, "$1-");
}

/** An authority as a bundle brings it: its keys, hexadecimal, the fleet's place, and the network's authority. */
export interface Authority {
  authority: { active: string; standby: string };
  fleet: { root: string; routers: string[] };
  ca: string;
}

/** The text of which the fingerprint of an authority is. */
export function authorityText({ authority, fleet, ca }: Authority): Bytes {
  const keys = [hexBytes(authority.active), hexBytes(authority.standby)];
  return signedText("A", utf8("authority"), ...keys, utf8(ca), utf8(fleet.root), ...fleet.routers.map(utf8));
}

/** A bundle for an operator, which its authority has signed. */
export class Bundle {
  private constructor(
    readonly name: string,
    /** The key that the grant is for, hexadecimal. */
    readonly key: string,
    /** The text of the grant. */
    readonly statement: string,
    /** The authority's active public key, hexadecimal. */
    readonly authority: string,
    /** Fingerprint of all that the bundle says of the authority, for the user to compare. */
    readonly fingerprint: string,
  ) {}

  static async read(text: string, nowS = Date.now() / 1000): Promise<Bundle> {
    const [body, signer, signature] = statementOf(text, "the bundle is not signed");
    if (!(await fits(signer, hexBytes(signature), signedText("A", utf8("bundle"), utf8(body))))) {
      throw new Error("the bundle was changed after it was signed");
    }
    const said = JSON.parse(body) as Authority & { role: string; name: string; chain: string };
    const { active, standby } = said.authority;
    if (said.role !== "operator" || !said.chain) throw new Error("this is no bundle of an operator");
    if (![active, standby].every((key) => KEY.test(key))) throw new Error("the bundle names no authority");
    if (signer !== active) throw new Error("the bundle is not signed by the authority that it names");
    const grant = await grantOf(said.chain, active, nowS);
    if (grant.name !== said.name || !["program", "operator", "supervisor"].includes(grant.role)) {
      throw new Error(`the grant is of ${grant.role} ${grant.name}`);
    }
    return new Bundle(grant.name, grant.key, said.chain, active, await fingerprint(authorityText(said)));
  }
}

interface Grant {
  kind: string;
  role: string;
  name: string;
  key: string;
  not_before: number;
  not_after: number;
}

/** The grant in a text, if the authority signed it, and it holds now. */
async function grantOf(text: string, authority: string, nowS: number): Promise<Grant> {
  const [body, signer, signature] = statementOf(text, "the grant cannot be read");
  if (signer !== authority) throw new Error("the grant is of another authority");
  if (!(await fits(signer, hexBytes(signature), signedText("A", utf8(body))))) {
    throw new Error("the signature of the grant does not fit");
  }
  const grant = JSON.parse(body) as Grant;
  if (grant.kind !== "grant" || !KEY.test(grant.key)) throw new Error("the grant cannot be read");
  if (!(grant.not_before <= nowS && Math.floor(nowS) <= grant.not_after)) {
    throw new Error("the grant has expired or is not valid yet");
  }
  return grant;
}

/** Body, signer and signature of two lines. */
function statementOf(text: string, otherwise: string): [string, string, string] {
  const [, body, signer, signature] = /^([^\n]+)\ned25519 ([0-9a-f]{64}) ([0-9a-f]{128})\n?$/.exec(text) ?? [];
  if (body === undefined || signer === undefined || signature === undefined) throw new Error(otherwise);
  return [body, signer, signature];
}

const KEY = /^[0-9a-f]{64}$/;

/** A lease: its number, and the key that its holder and the robot alone know. */
export class Lease {
  private constructor(
    readonly number: number,
    private readonly key: CryptoKey,
  ) {}

  /** A key pair for one lease, and the public half, which goes into `acquire` or `take`. */
  static async newKey(): Promise<[CryptoKeyPair, Bytes]> {
    const pair = (await crypto.subtle.generateKey("X25519", false, ["deriveKey"])) as CryptoKeyPair;
    return [pair, new Uint8Array(await crypto.subtle.exportKey("raw", pair.publicKey))];
  }

  /**
   * The lease of a verified reply to `acquire` or `take`. `theirs` is the reply's `public_key`, `attachment` the
   * reply's, `driveKey` the key expression of the drive commands.
   */
  static async agree(
    privateKey: CryptoKey,
    ours: Uint8Array,
    theirs: Uint8Array,
    attachment: Uint8Array,
    number: number,
    driveKey: string,
  ): Promise<Lease> {
    const other = await crypto.subtle.importKey("raw", concat(theirs), "X25519", false, []);
    const x25519 = { name: "X25519", public: other };
    const shared = await crypto.subtle.deriveKey(x25519, privateKey, "HKDF", false, ["deriveKey"]);
    const salt = signedText("L", runOf(attachment), bigEndian(number, 8), utf8(driveKey));
    const info = signedText("L", ...(hex(ours) < hex(theirs) ? [ours, theirs] : [theirs, ours]));
    const hkdf = { name: "HKDF", hash: "SHA-256", salt, info };
    const key = await crypto.subtle.deriveKey(hkdf, shared, { ...HMAC, length: 256 }, false, ["sign"]);
    return new Lease(number, key);
  }

  /** The attachment of a drive command, 25 bytes. */
  async attach(message: Message): Promise<Bytes> {
    const fields = concat(Uint8Array.of(VERSION), bigEndian(this.number, 8));
    const tag = await crypto.subtle.sign("HMAC", this.key, messageText("M", message, fields));
    return concat(fields, new Uint8Array(tag, 0, TAG_BYTES));
  }

  /** The attachment of a verb of the lease's holder, 105 bytes, from the signed one: no flood keeps it waiting. */
  async tag(message: Message, signed: Uint8Array): Promise<Bytes> {
    const text = messageText("S", message, signed.slice(0, VERB_FIELDS_BYTES));
    const tag = await crypto.subtle.sign("HMAC", this.key, text);
    return concat(signed, new Uint8Array(tag, 0, TAG_BYTES));
  }
}

const HMAC = { name: "HMAC", hash: "SHA-256" };

/** The identifier of a statement, from its JSON. */
export async function statementId(body: string): Promise<Bytes> {
  return (await sha256(utf8(body))).slice(0, 8);
}

/** Is it the signature of this key, hexadecimal, over this text? */
export async function fits(key: string, signature: Uint8Array, text: Bytes): Promise<boolean> {
  const known = await crypto.subtle.importKey("raw", hexBytes(key), "Ed25519", false, ["verify"]);
  return crypto.subtle.verify("Ed25519", known, concat(signature), text);
}

/** An Ed25519 key from a PEM file (PKCS8), which signs and cannot be taken out again. */
export async function privateKeyOfPem(pem: string): Promise<CryptoKey> {
  const der = Uint8Array.from(atob(pem.replace(/-----[A-Z ]+-----|\s/g, "")), (letter) => letter.charCodeAt(0));
  return crypto.subtle.importKey("pkcs8", der, "Ed25519", false, ["sign"]);
}

export function utf8(text: string): Bytes {
  return concat(new TextEncoder().encode(text));
}

export function hexBytes(text: string): Bytes {
  return Uint8Array.from(text.match(/../g) ?? [], (two) => parseInt(two, 16));
}

function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function bigEndian(value: number | bigint, bytes: number): Bytes {
  return hexBytes(value.toString(16).padStart(2 * bytes, "0"));
}

export function random(bytes: number): Bytes {
  return crypto.getRandomValues(new Uint8Array(bytes));
}

function concat(...parts: Uint8Array[]): Bytes {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}

async function sha256(text: Bytes): Promise<Bytes> {
  return new Uint8Array(await crypto.subtle.digest("SHA-256", text));
}
